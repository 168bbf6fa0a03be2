//! The rendered scenes: surfaces in metres in the left camera's frame (x right, y down, z forward) and the camera rig.

use crate::texture::Texture;

/// Two equal pinhole cameras, the right one `baseline_m` to the right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rig {
    /// Image width in pixels.
    pub width_px: usize,
    /// Image height in pixels.
    pub height_px: usize,
    /// Focal length in pixels; the principal point is the image's centre.
    pub focal_px: f64,
    /// Distance of the cameras in metres.
    pub baseline_m: f64,
}

impl Rig {
    /// The rig of the named scenes: 512 x 320 px, disparity = 100 px / depth in metres.
    pub const STANDARD: Self = Self {
        width_px: 512,
        height_px: 320,
        focal_px: 400.0,
        baseline_m: 0.25,
    };

    /// Column and row of the principal point in pixels.
    #[must_use]
    pub fn principal_px(&self) -> (f64, f64) {
        (
            (self.width_px as f64 - 1.0) / 2.0,
            (self.height_px as f64 - 1.0) / 2.0,
        )
    }

    /// Disparity in pixels at a depth.
    #[must_use]
    pub fn disparity_px(&self, depth_m: f64) -> f64 {
        self.focal_px * self.baseline_m / depth_m
    }
}

/// A shape in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// All points `p` with `normal . p = offset_m`.
    Plane {
        /// Normal, of any length.
        normal: [f64; 3],
        /// `normal . p`, in metres for a normal of length 1.
        offset_m: f64,
    },
    /// A box along the axes.
    Block {
        /// Corner of the smallest coordinates.
        min_m: [f64; 3],
        /// Corner of the largest coordinates.
        max_m: [f64; 3],
    },
    /// A sphere.
    Ball {
        /// Centre.
        centre_m: [f64; 3],
        /// Radius.
        radius_m: f64,
    },
}

impl Surface {
    /// The first `t > 0` with `origin + t * direction` on the surface.
    #[must_use]
    pub fn first_hit(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<f64> {
        match *self {
            Self::Plane { normal, offset_m } => {
                let slope = dot(normal, direction);
                let t = (offset_m - dot(normal, origin)) / slope;
                (slope != 0.0 && t > 0.0).then_some(t)
            }
            Self::Block { min_m, max_m } => {
                let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
                for axis in 0..3 {
                    if direction[axis] == 0.0 {
                        if !(min_m[axis]..=max_m[axis]).contains(&origin[axis]) {
                            return None;
                        }
                        continue;
                    }
                    let a = (min_m[axis] - origin[axis]) / direction[axis];
                    let b = (max_m[axis] - origin[axis]) / direction[axis];
                    enter = enter.max(a.min(b));
                    leave = leave.min(a.max(b));
                }
                (enter <= leave && enter > 0.0).then_some(enter)
            }
            Self::Ball { centre_m, radius_m } => {
                let to: [f64; 3] = std::array::from_fn(|i| origin[i] - centre_m[i]);
                let (a, half_b) = (dot(direction, direction), dot(to, direction));
                let root = half_b * half_b - a * (dot(to, to) - radius_m * radius_m);
                let t = (-half_b - root.max(0.0).sqrt()) / a;
                (root >= 0.0 && t > 0.0).then_some(t)
            }
        }
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Surfaces with their textures, seen by a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Name, as tests print it.
    pub name: &'static str,
    /// The cameras.
    pub rig: Rig,
    /// What there is to see.
    pub solids: Vec<(Surface, Texture)>,
}

impl Scene {
    /// Every named scene with texture that can be matched.
    #[must_use]
    pub fn all() -> Vec<Self> {
        vec![
            Self::slanted_planes(),
            Self::road(),
            Self::step_edge(),
            Self::sphere(),
            Self::repeated_texture(),
        ]
    }

    /// A room's corner: floor, a wall turned by 35 degrees and one turned by 20 degrees the other way.
    #[must_use]
    pub fn slanted_planes() -> Self {
        Self::standard(
            "slanted planes",
            vec![
                (
                    Surface::Plane {
                        normal: [0.0, 1.0, -0.05],
                        offset_m: 1.2,
                    },
                    rough(11),
                ),
                (
                    Surface::Plane {
                        normal: [-0.57, 0.0, 0.82],
                        offset_m: 3.4,
                    },
                    rough(12),
                ),
                (
                    Surface::Plane {
                        normal: [0.34, 0.1, 0.94],
                        offset_m: 4.0,
                    },
                    rough(13),
                ),
            ],
        )
    }

    /// A road with boxes and thin poles in front of a far wall.
    #[must_use]
    pub fn road() -> Self {
        let block = |min_m, max_m, seed| (Surface::Block { min_m, max_m }, rough(seed));
        Self::standard(
            "road with boxes and poles",
            vec![
                (
                    Surface::Plane {
                        normal: [0.0, 1.0, 0.0],
                        offset_m: 1.3,
                    },
                    rough(21),
                ),
                (
                    Surface::Plane {
                        normal: [0.05, 0.0, 1.0],
                        offset_m: 16.0,
                    },
                    rough(22),
                ),
                block([-2.6, -0.2, 4.0], [-1.4, 1.3, 6.5], 23),
                block([0.9, 0.3, 3.0], [1.7, 1.3, 3.9], 24),
                block([2.2, -1.0, 6.0], [4.2, 1.3, 8.0], 25),
                block([-0.62, -2.0, 3.4], [-0.56, 1.3, 3.46], 26),
                block([0.35, -2.0, 5.0], [0.43, 1.3, 5.08], 27),
                block([-1.0, -2.5, 7.0], [-0.86, 1.3, 7.14], 28),
            ],
        )
    }

    /// A near wall beside a far one.
    #[must_use]
    pub fn step_edge() -> Self {
        Self::standard(
            "step edge",
            vec![
                (
                    Surface::Plane {
                        normal: [0.0, 0.0, 1.0],
                        offset_m: 6.0,
                    },
                    rough(31),
                ),
                (
                    Surface::Block {
                        min_m: [0.1, -9.0, 3.0],
                        max_m: [9.0, 9.0, 3.2],
                    },
                    rough(32),
                ),
            ],
        )
    }

    /// A ball in front of a wall.
    #[must_use]
    pub fn sphere() -> Self {
        Self::standard(
            "sphere",
            vec![
                (
                    Surface::Plane {
                        normal: [0.0, 0.15, 1.0],
                        offset_m: 5.0,
                    },
                    rough(41),
                ),
                (
                    Surface::Ball {
                        centre_m: [0.0, 0.0, 2.9],
                        radius_m: 0.85,
                    },
                    rough(42),
                ),
            ],
        )
    }

    /// A wall with a broad band whose texture repeats every 24 px, inside the disparities that are searched.
    #[must_use]
    pub fn repeated_texture() -> Self {
        let (depth_m, period_px) = (4.0, 24.0);
        let period_m = period_px * depth_m / Rig::STANDARD.focal_px;
        Self::standard(
            "repeated texture",
            vec![
                (
                    Surface::Plane {
                        normal: [0.0, 0.0, 1.0],
                        offset_m: depth_m + 0.01,
                    },
                    rough(51),
                ),
                (
                    Surface::Block {
                        min_m: [-1.6, -0.5, depth_m],
                        max_m: [1.6, 0.5, depth_m + 0.005],
                    },
                    Texture::Repeating { seed: 52, period_m },
                ),
            ],
        )
    }

    /// A wall without any texture.
    #[must_use]
    pub fn textureless() -> Self {
        let wall = Surface::Plane {
            normal: [0.0, 0.0, 1.0],
            offset_m: 4.0,
        };
        Self::standard("textureless", vec![(wall, Texture::Plain { gray: 128.0 })])
    }

    fn standard(name: &'static str, solids: Vec<(Surface, Texture)>) -> Self {
        Self {
            name,
            rig: Rig::STANDARD,
            solids,
        }
    }
}

fn rough(seed: u32) -> Texture {
    // Surfaces differ in brightness as well, as they do in the world.
    let mean = 105.0 + f64::from(seed % 5) * 12.0;
    Texture::Rough {
        seed,
        mean,
        contrast: 36.0,
    }
}
