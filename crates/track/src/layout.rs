//! What the numbers of a state are called, and where positions stand in it.

/// Names and order of a state's components.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Column names in the order of the state: `x y vx vy`, or `x1 … xn` of a linear model.
    pub names: Vec<String>,
    /// Kinematic: number of axes; the position is the first `axes` components, the velocity (if modelled) the next `axes`.
    /// Linear: 0.
    pub axes: usize,
    /// Whether the components after the position are a velocity.
    pub has_velocity: bool,
}

impl Layout {
    /// The layout of `order` derivatives (1 position, 2 with velocity, 3 with acceleration) on `axes` axes, then `extra` names.
    pub fn kinematic(order: usize, axes: usize, extra: &[&str]) -> Layout {
        let mut names = Vec::new();
        for prefix in ["", "v", "a"].iter().take(order) {
            for axis in ["x", "y", "z"].iter().take(axes) {
                names.push(format!("{prefix}{axis}"));
            }
        }
        names.extend(extra.iter().map(|s| (*s).to_owned()));
        Layout { names, axes, has_velocity: order >= 2 }
    }

    /// The layout of a linear model of `n` states.
    pub fn linear(n: usize) -> Layout {
        Layout { names: (1..=n).map(|i| format!("x{i}")).collect(), axes: 0, has_velocity: false }
    }

    /// Number of state components.
    pub fn n(&self) -> usize {
        self.names.len()
    }

    /// Whether this is a linear model's layout.
    pub fn is_linear(&self) -> bool {
        self.axes == 0
    }
}
