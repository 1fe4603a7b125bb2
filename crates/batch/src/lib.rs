//! Tables in, trails out.
