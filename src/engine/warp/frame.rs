//! Frames of images. The source and the picture that is drawn of it lie in one plane, in px of the
//! source; a frame says where in it the positions of one of the two images lie.

use super::{OutputSpec, ResolvedRest, Target, Units};
use crate::geometry::Point;
use crate::pixmap::Extent;
use crate::render::Canvas;

/// The positions of an image, in the client's units, and the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoordinateFrame {
    canvas: Canvas,
    /// The size of the image, px.
    image: Extent,
    units: Units,
}

impl CoordinateFrame {
    /// The frame of the source.
    #[must_use]
    pub const fn of_source(source: Extent, units: Units) -> Self {
        Self {
            canvas: Canvas::of(source),
            image: source,
            units,
        }
    }

    /// The frame of a picture.
    #[must_use]
    pub fn of_target(target: Target, source: Extent, units: Units) -> Self {
        let canvas = target.canvas.unwrap_or(Canvas::of(source));
        Self {
            canvas,
            image: target.extent,
            units,
        }
    }

    /// The frame of the picture that is requested, as far as it is known before anything is posed:
    /// the canvas `fit` counts as the box of the source.
    #[must_use]
    pub fn requested(output: &OutputSpec, source: Extent, units: Units) -> Self {
        Self::on_canvas(
            output
                .canvas
                .before_pose(source)
                .unwrap_or(Canvas::of(source)),
            output,
            units,
        )
    }

    /// The frame of a picture that shows this part of the plane.
    #[must_use]
    pub fn on_canvas(canvas: Canvas, output: &OutputSpec, units: Units) -> Self {
        Self {
            canvas,
            image: output.size_of(canvas),
            units,
        }
    }

    /// px of the image in a px of the source, along each axis.
    #[must_use]
    pub fn scale(&self) -> [f64; 2] {
        let ratio = |image: u32, canvas: u32| f64::from(image) / f64::from(canvas);
        let (image, canvas) = (self.image, self.canvas.extent);
        [
            ratio(image.width(), canvas.width()),
            ratio(image.height(), canvas.height()),
        ]
    }

    /// px of the plane in one unit.
    fn unit(&self) -> [f64; 2] {
        let side = |canvas: u32, image: u32| match self.units {
            Units::Px => f64::from(canvas) / f64::from(image),
            Units::Normalized => f64::from(canvas),
        };
        let (image, canvas) = (self.image, self.canvas.extent);
        [
            side(canvas.width(), image.width()),
            side(canvas.height(), image.height()),
        ]
    }

    /// The place of a position in the plane, px.
    ///
    /// ```
    /// use mlswarp::geometry::Point;
    /// use mlswarp::pixmap::Extent;
    /// use mlswarp::warp::{CoordinateFrame, Units};
    /// let image = Extent::new(640, 480).unwrap();
    /// let frame = CoordinateFrame::of_source(image, Units::Normalized);
    /// assert_eq!(frame.to_plane(Point::new(0.5, 0.5)), Point::new(320.0, 240.0));
    /// ```
    #[must_use]
    pub fn to_plane(&self, position: Point) -> Point {
        let [across, down] = self.unit();
        let [left, top, ..] = self.canvas.edges();
        Point::new(left + position.x * across, top + position.y * down)
    }

    /// The position of a place in the plane.
    #[must_use]
    pub fn from_plane(&self, place: Point) -> Point {
        let [across, down] = self.unit();
        let [left, top, ..] = self.canvas.edges();
        Point::new((place.x - left) / across, (place.y - top) / down)
    }

    /// The size of the image, in units.
    #[must_use]
    pub fn size(&self) -> [f64; 2] {
        match self.units {
            Units::Px => [self.image.width(), self.image.height()].map(f64::from),
            Units::Normalized => [1.0; 2],
        }
    }

    /// The part of the plane that the image shows.
    #[must_use]
    pub const fn canvas(&self) -> Canvas {
        self.canvas
    }

    /// The size of the image, px.
    #[must_use]
    pub const fn image(&self) -> Extent {
        self.image
    }

    pub(super) const fn units(&self) -> Units {
        self.units
    }

    /// The longest distance in the plane that is at most `px` long in the image.
    pub(super) fn in_plane(&self, px: f64) -> f64 {
        let [across, down] = self.scale();
        px / across.max(down)
    }
}

impl ResolvedRest {
    /// The frame of the source.
    #[must_use]
    pub fn source_frame(&self) -> CoordinateFrame {
        CoordinateFrame::of_source(self.source(), self.units())
    }

    /// The frame of a picture.
    #[must_use]
    pub fn frame_of(&self, target: Target) -> CoordinateFrame {
        CoordinateFrame::of_target(target, self.source(), self.units())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(canvas: Canvas, image: (u32, u32), units: Units) -> CoordinateFrame {
        CoordinateFrame {
            canvas,
            image: Extent::new(image.0, image.1).unwrap(),
            units,
        }
    }

    #[test]
    fn positions_of_an_image_are_where_its_pixels_lie() {
        let canvas = Canvas {
            x: -20,
            y: 10,
            extent: Extent::new(200, 100).unwrap(),
        };
        let half = frame(canvas, (100, 50), Units::Px);
        assert_eq!(half.to_plane(Point::new(0.0, 0.0)), Point::new(-20.0, 10.0));
        assert_eq!(
            half.to_plane(Point::new(100.0, 50.0)),
            Point::new(180.0, 110.0)
        );
        assert_eq!(
            (half.scale(), half.size(), half.in_plane(0.1)),
            ([0.5; 2], [100.0, 50.0], 0.2)
        );
        let shares = frame(canvas, (100, 50), Units::Normalized);
        assert_eq!(
            shares.to_plane(Point::new(0.5, 1.0)),
            Point::new(80.0, 110.0)
        );
        assert_eq!((shares.scale(), shares.size()), ([0.5; 2], [1.0; 2]));
        for frame in [half, shares, frame(canvas, (333, 17), Units::Px)] {
            let place = Point::new(37.25, -4.5);
            assert!(frame.to_plane(frame.from_plane(place)).distance(place) < 1e-12);
        }
    }

    #[test]
    fn positions_of_the_source_are_the_plane_bit_for_bit() {
        let source = CoordinateFrame::of_source(Extent::new(301, 97).unwrap(), Units::Px);
        for place in [Point::new(0.1 + 0.2, -1e-300), Point::new(1e6, 77.7)] {
            assert_eq!(
                (source.to_plane(place), source.from_plane(place)),
                (place, place)
            );
        }
    }
}
