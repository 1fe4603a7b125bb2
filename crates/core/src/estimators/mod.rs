//! Estimators, one algorithm per file.

pub mod diffuse;
pub mod fms;
pub mod kalman;
pub mod smoother;
pub mod ufir;
