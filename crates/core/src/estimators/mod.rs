//! Estimators, one algorithm per file.

pub mod alpha_beta;
pub mod augmented;
pub mod diffuse;
pub mod emvf;
pub mod fms;
pub mod fosb;
pub mod gpb1;
pub mod imm;
pub mod kalman;
pub mod lmmse;
pub mod lmvf;
pub mod mixture;
pub mod smoother;
pub mod ufir;
