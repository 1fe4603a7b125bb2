//! One file per command.

pub mod check;
pub mod compare;
pub mod demo;
pub mod list;
pub mod reproduce;
pub mod simulate;
pub mod track;
pub mod tune;
pub mod verify;
