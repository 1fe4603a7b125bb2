//! A small Gaussian factor graph: filters and smoothers as orders of sending messages.
//!
//! ```text
//! variable → factor   the product of the messages from its other factors      (extrinsic: nothing comes back to its sender)
//! factor → variable   the factor times the messages from its other variables, those variables integrated out
//! belief              the product of all messages to the variable
//! ```
//!
//! Variables are vectors of one length N. A message is a mean and a covariance where the variable is determined, and information where it
//! is not, 0 before anything is sent ([`Message`]). On a tree, in any order in which a message is sent after those it is made of, the result is exact:
//! the Kalman filter is the sends onward, the Rauch–Tung–Striebel smoother those and then the sends back, a fixed-lag smoother a few sends back after
//! each one onward ([`schedule`]). FOSB \[FOSB12\] is a schedule on a graph of scalars that has loops, some of whose messages are never sent.
//! Sending more of them is no remedy: on that graph the variances do not come out right however often messages go round. A vector of
//! location and speed makes it a tree.
//!
//! ```
//! use fixtrail_core::graph::{Factor, Graph, Message, Send};
//! use fixtrail_core::{Belief, Matrix, Row, Vector};
//!
//! // A random walk seen twice.
//! let at = |z: f64| [Row { h: Vector::from([1.0]), residual: z, var: 1.0 }];
//! let one = Matrix::<1, 1>::identity();
//! let factors = [
//!     Factor::observation(0, &at(0.0)),
//!     Factor::transition(0, 1, one, Vector::zeros(), one),
//!     Factor::observation(1, &at(3.0)),
//! ];
//! let mut messages = [[Message::vacuous(); 3]; 3];
//! let mut graph = Graph::new(&factors, &mut messages).unwrap();
//! let sends = [(0, 0), (1, 1), (2, 0)].map(|(factor, slot)| Send { factor, slot });
//! graph.run(sends)?;
//! let Belief { mean, cov } = graph.belief(1)?.unwrap();
//! assert!((mean[0] - 2.0).abs() < 1e-12 && (cov[0] - 2.0 / 3.0).abs() < 1e-12);
//! # Ok::<(), fixtrail_core::graph::GraphError>(())
//! ```

mod factor;
mod message;
pub mod schedule;

pub use factor::Factor;
pub use message::Message;

use crate::types::Belief;

/// Most variables of a factor.
pub const ARITY: usize = 3;

/// One message to be sent: from a factor to the variable in one of its slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Send {
    /// Index of the factor.
    pub factor: usize,
    /// Which of its variables.
    pub slot: usize,
}

/// Why a message cannot be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GraphError {
    /// No such factor or slot.
    #[error("there is no slot {slot} of factor {factor}")]
    NoSlot {
        /// The factor.
        factor: usize,
        /// The slot.
        slot: usize,
    },
    /// The message is of no form that a [`Message`] has: it is certain of some directions and says nothing of others.
    #[error(
        "factor {factor} has no message to its slot {slot}: it would be certain of some directions and open in others"
    )]
    NoMessage {
        /// The factor.
        factor: usize,
        /// The slot.
        slot: usize,
    },
    /// Two messages are certain of the same direction of a variable.
    #[error("two messages are certain of the same direction of variable {variable}")]
    Contradiction {
        /// The variable.
        variable: usize,
    },
}

/// Factors, and the last message of each to each of its variables.
#[derive(Debug)]
pub struct Graph<'a, const N: usize> {
    factors: &'a [Factor<N>],
    messages: &'a mut [[Message<N>; ARITY]],
}

impl<'a, const N: usize> Graph<'a, N> {
    /// A graph that keeps its messages in the storage lent, which may hold those of an earlier run. `None` when there is not one entry for each
    /// factor.
    pub fn new(factors: &'a [Factor<N>], messages: &'a mut [[Message<N>; ARITY]]) -> Option<Self> {
        (messages.len() == factors.len()).then_some(Self { factors, messages })
    }

    /// Sends messages in order.
    ///
    /// # Errors
    /// [`GraphError`] of the first that cannot be sent; those before it have been.
    pub fn run(&mut self, schedule: impl IntoIterator<Item = Send>) -> Result<(), GraphError> {
        schedule.into_iter().try_for_each(|send| self.send(send))
    }

    /// Sends one message, made of what is on the other edges now.
    ///
    /// # Errors
    /// [`GraphError`]; nothing has changed then.
    pub fn send(&mut self, Send { factor, slot }: Send) -> Result<(), GraphError> {
        let of = self.factors.get(factor).filter(|of| slot < of.variables().len());
        let of = of.ok_or(GraphError::NoSlot { factor, slot })?;
        let mut from = [Message::vacuous(); ARITY];
        for (other, variable) in of.variables().iter().enumerate() {
            if other != slot {
                from[other] = self.product(*variable, Some(factor))?;
            }
        }
        self.messages[factor][slot] = of.message(slot, &from).ok_or(GraphError::NoMessage { factor, slot })?;
        Ok(())
    }

    /// What is known of a variable; `None` when what was sent does not determine it.
    ///
    /// # Errors
    /// [`GraphError::Contradiction`].
    pub fn belief(&self, variable: usize) -> Result<Option<Belief<N>>, GraphError> {
        Ok(self.product(variable, None)?.belief())
    }

    /// The last message from a factor to the variable in one of its slots.
    pub fn message(&self, Send { factor, slot }: Send) -> Option<&Message<N>> {
        self.messages.get(factor)?.get(slot)
    }

    /// The product of the messages to a variable, without those of one factor. Looks at every factor.
    fn product(&self, variable: usize, but: Option<usize>) -> Result<Message<N>, GraphError> {
        let mut out = Message::vacuous();
        for (i, factor) in self.factors.iter().enumerate().filter(|(i, _)| Some(*i) != but) {
            for (slot, _) in factor.variables().iter().enumerate().filter(|(_, v)| **v == variable) {
                out = out.times(&self.messages[i][slot]).ok_or(GraphError::Contradiction { variable })?;
            }
        }
        Ok(out)
    }
}
