//! Positions and displacements in the plane, f64, px. A [`Vec2`] is also the complex number
//! `x + iy`: a rotation or similarity of the paper, `x -> x M` with `M2 = M1_perp`, is a
//! multiplication by a complex `m`.

use std::ops::{Add, AddAssign, Mul, Neg, Sub};

use super::lane_math;

/// A position in the plane, px.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Rightwards, px.
    pub x: f64,
    /// Downwards, px.
    pub y: f64,
}

/// A displacement, px; also the complex number `x + iy`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vec2 {
    /// Rightwards, px (the real part).
    pub x: f64,
    /// Downwards, px (the imaginary part).
    pub y: f64,
}

impl Point {
    /// The position `(x, y)`.
    #[must_use]
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// The position a fraction `t` of the way to `other`; exactly `self` at 0 and `other` at 1.
    ///
    /// ```
    /// use mlswarp::geometry::Point;
    /// let (a, b) = (Point::new(0.0, 0.0), Point::new(4.0, 2.0));
    /// assert_eq!(a.lerp(b, 0.5), Point::new(2.0, 1.0));
    /// ```
    #[must_use]
    pub fn lerp(self, other: Self, t: f64) -> Self {
        Self::new(
            (1.0 - t) * self.x + t * other.x,
            (1.0 - t) * self.y + t * other.y,
        )
    }

    /// Distance to `other`, px.
    ///
    /// ```
    /// use mlswarp::geometry::Point;
    /// assert_eq!(Point::new(1.0, 1.0).distance(Point::new(4.0, 5.0)), 5.0);
    /// ```
    #[must_use]
    pub fn distance(self, other: Self) -> f64 {
        (other - self).norm()
    }

    /// Whether neither coordinate is NaN or infinite.
    #[must_use]
    pub fn is_finite(self) -> bool {
        self.x.is_finite() && self.y.is_finite()
    }
}

impl Vec2 {
    /// The zero displacement.
    pub const ZERO: Self = Self::new(0.0, 0.0);

    /// The displacement `(x, y)`.
    #[must_use]
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// Length, px.
    #[must_use]
    pub fn norm(self) -> f64 {
        lane_math::hypot(self.x, self.y)
    }

    /// The unit vector at half of this one's angle, which lies in [-pi, pi]: the axis of the
    /// moments `(xx - yy, 2 xy)`. Of zero, `(1, 0)`.
    pub(crate) fn half_angle(self) -> Self {
        let length = self.norm();
        if length == 0.0 {
            return Self::new(1.0, 0.0);
        }
        // The larger of the two first: its square has no cancellation.
        let larger = (0.5 + 0.5 * (self.x.abs() / length)).sqrt();
        let smaller = 0.5 * (self.y / length) / larger;
        if self.x >= 0.0 {
            Self::new(larger, smaller)
        } else {
            Self::new(smaller.abs(), larger.copysign(self.y))
        }
    }

    /// Squared length, px^2.
    #[must_use]
    pub fn norm2(self) -> f64 {
        self.x * self.x + self.y * self.y
    }

    /// `Re(conj(self) other)`.
    #[must_use]
    pub fn dot(self, other: Self) -> f64 {
        self.x * other.x + self.y * other.y
    }

    /// `Im(conj(self) other) = x1 y2 - y1 x2`.
    ///
    /// ```
    /// use mlswarp::geometry::Vec2;
    /// // Positive from right to down: y points down.
    /// assert!(Vec2::new(1.0, 0.0).cross(Vec2::new(0.0, 1.0)) > 0.0);
    /// ```
    #[must_use]
    pub fn cross(self, other: Self) -> f64 {
        self.x * other.y - self.y * other.x
    }

    /// The complex conjugate `x - iy`.
    #[must_use]
    pub const fn conj(self) -> Self {
        Self::new(self.x, -self.y)
    }

    /// The complex product.
    ///
    /// ```
    /// use mlswarp::geometry::Vec2;
    /// // A quarter turn, and twice as long.
    /// let turned = Vec2::new(0.0, 2.0).complex_mul(Vec2::new(3.0, 0.0));
    /// assert_eq!(turned, Vec2::new(0.0, 6.0));
    /// ```
    #[must_use]
    pub fn complex_mul(self, other: Self) -> Self {
        Self::new(
            self.x * other.x - self.y * other.y,
            self.x * other.y + self.y * other.x,
        )
    }
}

impl Sub for Point {
    type Output = Vec2;
    fn sub(self, other: Self) -> Vec2 {
        Vec2::new(self.x - other.x, self.y - other.y)
    }
}

impl Add<Vec2> for Point {
    type Output = Self;
    fn add(self, d: Vec2) -> Self {
        Self::new(self.x + d.x, self.y + d.y)
    }
}

impl Sub<Vec2> for Point {
    type Output = Self;
    fn sub(self, d: Vec2) -> Self {
        Self::new(self.x - d.x, self.y - d.y)
    }
}

impl Add for Vec2 {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y)
    }
}

impl AddAssign for Vec2 {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Vec2 {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y)
    }
}

impl Neg for Vec2 {
    type Output = Self;
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y)
    }
}

impl Mul<f64> for Vec2 {
    type Output = Self;
    fn mul(self, s: f64) -> Self {
        Self::new(self.x * s, self.y * s)
    }
}
