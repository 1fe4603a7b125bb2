//! WGS 84 latitude, longitude, height ↔ metres in a local east-north-up frame.
//!
//! The frame is the plane tangent to the ellipsoid at the origin (an exact rotation of earth-centred coordinates, no map
//! projection), so distances and angles in it are true at any distance; "up" is height above that plane, which far
//! from the origin is not height above the ellipsoid (8 m less at 10 km).

/// Semi-major axis of the WGS 84 ellipsoid, metres.
const A_M: f64 = 6_378_137.0;
/// Flattening of the WGS 84 ellipsoid.
const F: f64 = 1.0 / 298.257_223_563;
/// First eccentricity squared.
const E2: f64 = F * (2.0 - F);

/// Where a local frame touches the earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Origin {
    /// Geodetic latitude in degrees, north positive.
    pub lat_deg: f64,
    /// Longitude in degrees, east positive.
    pub lon_deg: f64,
    /// Height above the ellipsoid in metres; 0 when the data have no heights.
    pub alt_m: f64,
}

/// Returns the east, north and up coordinates in metres of a geodetic position (degrees, metres above the ellipsoid).
pub fn enu_from_wgs84(origin: &Origin, lat_deg: f64, lon_deg: f64, alt_m: f64) -> [f64; 3] {
    let at = ecef(lat_deg, lon_deg, alt_m);
    let from = ecef(origin.lat_deg, origin.lon_deg, origin.alt_m);
    let d = [at[0] - from[0], at[1] - from[1], at[2] - from[2]];
    ecef_axes(origin).map(|axis| axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2])
}

/// Returns latitude and longitude in degrees (longitude in (-180, 180]) and height in metres of a local position.
///
/// Bowring's iteration on the parametric latitude; exact to rounding anywhere more than 50 km from the earth's centre.
pub fn wgs84_from_enu(origin: &Origin, enu_m: [f64; 3]) -> (f64, f64, f64) {
    let from = ecef(origin.lat_deg, origin.lon_deg, origin.alt_m);
    let axes = ecef_axes(origin);
    let component = |i: usize| from[i] + (0..3).map(|j| axes[j][i] * enu_m[j]).sum::<f64>();
    let (x, y, z) = (component(0), component(1), component(2));

    let p = x.hypot(y);
    let b = A_M * (1.0 - F);
    let second_e2 = E2 / (1.0 - E2);
    let mut beta = z.atan2(p * (1.0 - F));
    let mut lat = f64::NAN;
    // Cubic convergence: within 1000 km of the ellipsoid the second pass is at rounding, more are for deep points.
    for _ in 0..8 {
        let before = lat;
        lat = (z + second_e2 * b * beta.sin().powi(3)).atan2(p - E2 * A_M * beta.cos().powi(3));
        if (lat - before).abs() < 1e-16 {
            break;
        }
        beta = ((1.0 - F) * lat.sin()).atan2(lat.cos());
    }
    // This form of the height holds at the poles and on the equator alike.
    let alt_m = p * lat.cos() + z * lat.sin() - A_M * (1.0 - E2 * lat.sin().powi(2)).sqrt();
    (lat.to_degrees(), y.atan2(x).to_degrees(), alt_m)
}

/// Returns latitude and longitude in degrees of the point above or below (east, north) that is as high as the origin.
///
/// The inverse of [`enu_from_wgs84`] for data without heights: there "up" is not a state but follows from the curvature
/// of the earth.
pub fn wgs84_on_level(origin: &Origin, east_m: f64, north_m: f64) -> (f64, f64) {
    let mut up_m = 0.0;
    let mut at = wgs84_from_enu(origin, [east_m, north_m, up_m]);
    // Each pass leaves 1 - cos(angle from the origin) of the miss, 0.012 at 1000 km: 9 passes bring 80 km below 1e-9 m.
    for _ in 0..16 {
        let miss_m = at.2 - origin.alt_m;
        if miss_m.abs() < 1e-9 {
            break;
        }
        up_m -= miss_m;
        at = wgs84_from_enu(origin, [east_m, north_m, up_m]);
    }
    (at.0, at.1)
}

/// Earth-centred, earth-fixed coordinates in metres.
fn ecef(lat_deg: f64, lon_deg: f64, alt_m: f64) -> [f64; 3] {
    let (sin_lat, cos_lat) = lat_deg.to_radians().sin_cos();
    let (sin_lon, cos_lon) = lon_deg.to_radians().sin_cos();
    let n = A_M / (1.0 - E2 * sin_lat * sin_lat).sqrt();
    [(n + alt_m) * cos_lat * cos_lon, (n + alt_m) * cos_lat * sin_lon, (n * (1.0 - E2) + alt_m) * sin_lat]
}

/// The east, north and up axes at the origin in earth-centred coordinates.
fn ecef_axes(origin: &Origin) -> [[f64; 3]; 3] {
    let (sin_lat, cos_lat) = origin.lat_deg.to_radians().sin_cos();
    let (sin_lon, cos_lon) = origin.lon_deg.to_radians().sin_cos();
    [
        [-sin_lon, cos_lon, 0.0],
        [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
        [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Origin, position (degrees, degrees, metres) and east-north-up metres from PROJ 9.5.1 (pyproj 3.7.2):
    /// `+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 +lon_0=… +lat_0=… +h_0=…`.
    const PROJ: [([f64; 3], [f64; 3], [f64; 3]); 12] = [
        ([47.5, 8.5, 0.0], [47.5, 8.5, 0.0], [0.0, 0.0, 0.0]),
        ([47.5, 8.5, 400.0], [47.6, 8.7, 1234.5], [15042.952262362542, 11139.662407955759, 807.0580977171767]),
        ([50.78, -1.12, 0.0], [50.78, -2.5, 0.0], [-97320.77856558289, 908.0294596388887, -741.0987027559704]),
        ([90.0, 0.0, 0.0], [89.99, 45.0, 100.0], [789.8080408905369, -789.8080408901451, 99.90252709202473]),
        ([-90.0, 0.0, 10.0], [-89.5, -120.0, 0.0], [-48364.285598909686, -27923.13330969483, -253.67682202067397]),
        ([0.0, 180.0, 0.0], [0.1, -179.9, 50.0], [11132.013852559061, 11057.509347512883, 30.63598307035727]),
        ([-17.7, 179.95, 5.0], [-17.6, -179.95, 20.0], [10614.146547534712, 11064.85609977043, -3.4824673560669908]),
        ([-33.9, 151.2, 30.0], [-33.5, 150.9, 11000.0], [-27924.66389508431, 44402.45086807902, 10754.185405739616]),
        ([0.0, 0.0, 0.0], [5.0, 7.0, 0.0], [774361.1984699381, 552183.9600277696, -71471.13927923329]),
        ([64.1, -21.9, 50.0], [64.2, -21.5, -20.0], [19432.458506164145, 11208.944650262052, -109.35771783708515]),
        ([-54.8, -68.3, 0.0], [-55.9, -67.2, 0.0], [68804.93171550204, -122995.14595017474, -1556.2929327920501]),
        ([37.4, -122.1, 10.0], [40.0, -112.0, 9000.0], [859227.1619044067, 335051.6911938962, -57885.84459754592]),
    ];

    /// Both sides round earth-centred coordinates of 6.4e6 m, whose unit in the last place is 9e-10 m; a few of them add up.
    const ROUNDING_M: f64 = 5e-9;

    fn origin([lat_deg, lon_deg, alt_m]: [f64; 3]) -> Origin {
        Origin { lat_deg, lon_deg, alt_m }
    }

    /// Distance in metres between two geodetic positions, small angles.
    fn gap_m(a: (f64, f64, f64), b: [f64; 3]) -> f64 {
        let dlon = (a.1 - b[1] + 540.0).rem_euclid(360.0) - 180.0;
        let east = dlon.to_radians() * A_M * b[0].to_radians().cos();
        let north = (a.0 - b[0]).to_radians() * A_M;
        east.hypot(north).hypot(a.2 - b[2])
    }

    #[test]
    fn enu_of_known_points_is_projs() {
        for (from, at, expected) in PROJ {
            let enu = enu_from_wgs84(&origin(from), at[0], at[1], at[2]);
            for i in 0..3 {
                assert!((enu[i] - expected[i]).abs() < ROUNDING_M, "{from:?} {at:?}: {enu:?}, PROJ {expected:?}");
            }
        }
    }

    #[test]
    fn wgs84_of_known_points_is_projs() {
        for (from, at, enu) in PROJ {
            let back = wgs84_from_enu(&origin(from), enu);
            assert!(gap_m(back, at) < ROUNDING_M, "{from:?} {enu:?}: {back:?}, expected {at:?}");
        }
    }

    #[test]
    fn there_and_back_is_exact_within_1000_km() {
        for from in [[0.0, 0.0, 0.0], [89.9, 10.0, 50.0], [-45.0, 180.0, -20.0], [51.5, -0.1, 3000.0]] {
            for i in 0..200 {
                // A spiral out to 1000 km, 20 km above to 5 km below the plane.
                let (r, angle) = (5_000.0 * f64::from(i), 0.7 * f64::from(i));
                let enu = [r * angle.cos(), r * angle.sin(), 20_000.0 - 125.0 * f64::from(i)];
                let (lat, lon, alt) = wgs84_from_enu(&origin(from), enu);
                let back = enu_from_wgs84(&origin(from), lat, lon, alt);
                for j in 0..3 {
                    assert!((back[j] - enu[j]).abs() < ROUNDING_M, "{from:?} {enu:?}: {back:?}");
                }
            }
        }
    }

    #[test]
    fn level_points_come_back_without_their_height() {
        for (from, at, _) in PROJ {
            let enu = enu_from_wgs84(&origin(from), at[0], at[1], from[2]);
            let (lat, lon) = wgs84_on_level(&origin(from), enu[0], enu[1]);
            // The height is met to 1e-9 m, and moves the point sideways by less than that.
            assert!(gap_m((lat, lon, from[2]), [at[0], at[1], from[2]]) < ROUNDING_M, "{from:?} {at:?}: {lat} {lon}");
        }
    }
}
