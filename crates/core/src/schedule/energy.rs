//! What measuring and talking costs a sensor.

use super::DesignError;

/// The first-order radio: energy grows with the bits, and when sending with a power of the distance.
///
/// ```text
/// E_sense = e_s b_s     E_receive = e_r b_c     E_send(d) = (e_t + e_d d^α) b_c
/// ```
///
/// \[MVF10, sec. 4.2.3\] names the terms and not the constants. [`Radio::default`] has the usual ones: 45 nJ/bit and 10 pJ/bit/m² to send,
/// 135 nJ/bit to receive, 50 nJ/bit to sense, 1024 bits each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Radio {
    /// `e_s`, mJ per bit sensed.
    pub sense_mj_per_bit: f64,
    /// `e_r`, mJ per bit received.
    pub receive_mj_per_bit: f64,
    /// `e_t`, mJ per bit sent, whatever the distance.
    pub send_mj_per_bit: f64,
    /// `e_d`, mJ per bit sent and metre to the power of α.
    pub amplify_mj_per_bit: f64,
    /// α, the exponent of the distance.
    pub path_exponent: f64,
    /// `b_s`, bits of a measurement.
    pub sensed_bits: f64,
    /// `b_c`, bits of what one sensor tells the next.
    pub sent_bits: f64,
    /// Whether a sensor that goes on measuring spends what sensing takes and nothing on talking.
    pub free_self: bool,
}

impl Default for Radio {
    fn default() -> Self {
        Radio {
            sense_mj_per_bit: 5e-5,
            receive_mj_per_bit: 1.35e-4,
            send_mj_per_bit: 4.5e-5,
            amplify_mj_per_bit: 1e-8,
            path_exponent: 2.0,
            sensed_bits: 1024.0,
            sent_bits: 1024.0,
            free_self: false,
        }
    }
}

impl Radio {
    /// Checks that every constant is a number from 0 on.
    ///
    /// # Errors
    /// [`DesignError::Energy`].
    pub fn checked(self) -> Result<Radio, DesignError> {
        let named = [
            ("sense_mj_per_bit", self.sense_mj_per_bit),
            ("receive_mj_per_bit", self.receive_mj_per_bit),
            ("send_mj_per_bit", self.send_mj_per_bit),
            ("amplify_mj_per_bit", self.amplify_mj_per_bit),
            ("path_exponent", self.path_exponent),
            ("sensed_bits", self.sensed_bits),
            ("sent_bits", self.sent_bits),
        ];
        match named.into_iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
            Some((name, value)) => Err(DesignError::Energy { name, value }),
            None => Ok(self),
        }
    }

    /// Returns the energy of one measurement, mJ.
    pub fn sense_mj(&self) -> f64 {
        self.sense_mj_per_bit * self.sensed_bits
    }

    /// Returns the energy of taking over, mJ.
    pub fn receive_mj(&self) -> f64 {
        self.receive_mj_per_bit * self.sent_bits
    }

    /// Returns the energy of handing over to a sensor `distance_m` away, mJ.
    pub fn send_mj(&self, distance_m: f64) -> f64 {
        (self.send_mj_per_bit + self.amplify_mj_per_bit * libm::pow(distance_m, self.path_exponent)) * self.sent_bits
    }
}

/// One sensor: where it is, and what it has left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Battery {
    /// Its place, m.
    pub position_m: [f64; 2],
    /// Energy left, mJ; infinite where nobody counts.
    pub residual_mj: f64,
    /// Whether it works at all.
    pub alive: bool,
}

impl Battery {
    /// Distance to a place, m.
    pub fn distance_m(&self, to_m: [f64; 2]) -> f64 {
        libm::hypot(self.position_m[0] - to_m[0], self.position_m[1] - to_m[1])
    }
}
