//! Procedural textures: continuous functions of a point in space, so that both views see the same surface at any
//! sub-pixel position.
//!
//! The base is value noise: random values on an integer lattice, blended smoothly. Octaves are summed over the
//! wavelengths between 2 and 64 px as seen from the point's distance, which gives every surface the same contrast and
//! fine detail wherever it is, and nothing finer than a pixel can hold.

/// What a surface looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Texture {
    /// Rough, without repetition.
    Rough {
        /// Chooses the noise.
        seed: u32,
        /// Mean gray value, 0..=255.
        mean: f64,
        /// Standard deviation of the gray value, about.
        contrast: f64,
    },
    /// The same, repeating along x.
    Repeating {
        /// Chooses the noise.
        seed: u32,
        /// Distance after which it repeats, in metres.
        period_m: f64,
    },
    /// One gray value everywhere.
    Plain {
        /// Gray value, 0..=255.
        gray: f64,
    },
}

impl Texture {
    /// Gray value (0..=255, may leave it slightly) at `point` (metres) where one pixel covers `footprint_m`.
    #[must_use]
    pub fn gray(&self, point: [f64; 3], footprint_m: f64) -> f64 {
        match *self {
            Self::Rough { seed, mean, contrast } => mean + contrast * octaves(seed, point, footprint_m),
            Self::Repeating { seed, period_m } => {
                // Around a circle of that circumference noise repeats exactly, without a seam.
                let radius = period_m / std::f64::consts::TAU;
                let (sin, cos) = (point[0] / radius).sin_cos();
                128.0 + 45.0 * octaves(seed, [radius * cos, radius * sin, point[1]], footprint_m)
            }
            Self::Plain { gray } => gray,
        }
    }
}

/// Noise of about unit variance, with wavelengths from 2 to 64 times `footprint_m`.
fn octaves(seed: u32, point: [f64; 3], footprint_m: f64) -> f64 {
    // Wavelengths are absolute powers of two in metres; how much each counts depends on the footprint and fades in
    // and out over a factor of two, so that there is no seam where an octave begins.
    let finest = footprint_m.log2() + 1.0;
    let point = turned(point);
    let (mut sum, mut power) = (0.0, 0.0);
    let mut exponent = finest.ceil();
    while exponent <= finest + 5.0 {
        let weight = (exponent - finest).min(finest + 5.0 - exponent).clamp(0.0, 1.0);
        let frequency = (-exponent).exp2();
        let octave = seed.wrapping_mul(0x9e37_79b9) ^ octave_key(exponent);
        sum += weight * value_noise(octave, point.map(|c| c * frequency));
        power += weight * weight;
        exponent += 1.0;
    }
    // Values even over -1..1 have a variance of 1/3; blending leaves 0.74 of it in each direction.
    sum / (0.135 * power.max(1e-9)).sqrt()
}

/// Turned so that no wall of a scene lies in the lattice's planes, where the noise would look different.
fn turned([x, y, z]: [f64; 3]) -> [f64; 3] {
    [
        (2.0 * x - y + 2.0 * z) / 3.0,
        (2.0 * x + 2.0 * y - z) / 3.0,
        (-x + 2.0 * y + 2.0 * z) / 3.0,
    ]
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the logarithm of a length in metres is a small whole number here"
)]
fn octave_key(exponent: f64) -> u32 {
    (exponent as i32).cast_unsigned().wrapping_mul(0x85eb_ca6b)
}

/// Smoothly blended lattice noise in -1..1; the lattice has unit spacing.
fn value_noise(seed: u32, point: [f64; 3]) -> f64 {
    let cell = point.map(f64::floor);
    let blend: [f64; 3] = std::array::from_fn(|i| {
        let t = point[i] - cell[i];
        t * t * (3.0 - 2.0 * t)
    });
    let corner = cell.map(lattice_index);
    let value = |x: u32, y: u32, z: u32| {
        let at = [
            corner[0].wrapping_add(x),
            corner[1].wrapping_add(y),
            corner[2].wrapping_add(z),
        ];
        signed_unit(hash(seed, at))
    };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let along_x = |y: u32, z: u32| mix(value(0, y, z), value(1, y, z), blend[0]);
    let along_y = |z: u32| mix(along_x(0, z), along_x(1, z), blend[1]);
    mix(along_y(0), along_y(1), blend[2])
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "scenes are metres across: lattice indices are far inside i32"
)]
fn lattice_index(coordinate: f64) -> u32 {
    (coordinate as i32).cast_unsigned()
}

/// A well-mixed 32-bit hash of a seed and three numbers.
#[must_use]
pub(crate) fn hash(seed: u32, at: [u32; 3]) -> u32 {
    let mut h = seed;
    for value in at {
        h = (h ^ value).wrapping_mul(0x7feb_352d);
        h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
        h ^= h >> 16;
    }
    h
}

/// A hash as a number in -1..1.
#[must_use]
pub(crate) fn signed_unit(hash: u32) -> f64 {
    f64::from(hash) / f64::from(u32::MAX) * 2.0 - 1.0
}

#[cfg(test)]
mod tests {
    use super::Texture;

    #[test]
    fn textures_are_continuous_and_have_the_contrast_they_say() {
        let texture = Texture::Rough {
            seed: 3,
            mean: 120.0,
            contrast: 40.0,
        };
        let at = |x: f64| texture.gray([x, 0.37, 5.0], 0.01);
        let values: Vec<f64> = (0..20_000).map(|i| at(f64::from(i) * 0.01)).collect();
        let mean = values.iter().sum::<f64>() / 20_000.0;
        let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 20_000.0).sqrt();
        assert!((mean - 120.0).abs() < 8.0, "{mean}");
        assert!((30.0..50.0).contains(&deviation), "{deviation}");
        for i in 0..1000 {
            let x = f64::from(i) * 0.0031;
            assert!((at(x) - at(x + 1e-7)).abs() < 0.05);
        }
    }

    #[test]
    fn a_repeating_texture_repeats_after_its_period_only() {
        let texture = Texture::Repeating {
            seed: 3,
            period_m: 0.5,
        };
        let at = |x: f64| texture.gray([x, 0.2, 5.0], 0.01);
        assert!((at(0.1) - at(0.6)).abs() < 1e-6);
        assert!((0..10).any(|i| (at(f64::from(i) * 0.1) - at(f64::from(i) * 0.1 + 0.25)).abs() > 10.0));
    }
}
