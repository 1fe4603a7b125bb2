//! A linear model with its data, run through the pipeline.

use crate::anchors::Anchors;
use crate::error::BuildError;
use crate::packet::{Content, Packet};
use crate::pipeline;
use crate::spec::{EstimatorSpec, LinearSpec, LinkSpec, ModelSpec, Spec};
use crate::target::TargetPackets;
use crate::trackers::LaggedMode;
use crate::trail::Trail;

/// A linear model and its data.
#[derive(Clone)]
pub(super) struct LinearRun {
    pub(super) spec: LinearSpec,
    pub(super) packets: Vec<Packet>,
}

impl LinearRun {
    /// Runs an estimator through the pipeline.
    pub(super) fn track(&self, estimator: EstimatorSpec, lagged: LaggedMode) -> Result<Trail, BuildError> {
        self.track_link(estimator, LinkSpec::default(), lagged)
    }

    /// The spec of an estimator behind a link.
    pub(super) fn spec(&self, estimator: EstimatorSpec, link: LinkSpec) -> Spec {
        Spec {
            model: ModelSpec::Linear(self.spec.clone()),
            estimator,
            link,
            sensors: Vec::new(),
            columns: Default::default(),
            anchors: None,
            side_m: None,
        }
    }

    /// Runs an estimator behind a link through the pipeline.
    pub(super) fn track_link(
        &self,
        estimator: EstimatorSpec,
        link: LinkSpec,
        lagged: LaggedMode,
    ) -> Result<Trail, BuildError> {
        let spec = self.spec(estimator, link);
        let packets = TargetPackets { target: None, packets: self.packets.clone() };
        let trail = pipeline::track(&spec, &Anchors::default(), &packets, lagged)
            .map_err(|e| BuildError::new("vectors", None, None, e.to_string()))?;
        Ok(trail.trail)
    }
}

/// The full covariance of a row.
pub(super) fn unpacked(trail: &Trail, row: usize) -> Option<Vec<f64>> {
    let n = trail.n();
    (0..n * n).map(|e| trail.cov_at(row, e / n, e % n)).collect()
}

/// One row of a linear run.
pub(super) fn packet(k: usize, z: Vec<Option<f64>>, u: Vec<f64>) -> Packet {
    Packet { k: Some(k as u64), ..Packet::new(k as f64, Content::Linear { z, u }, k as u64 + 1) }
}
