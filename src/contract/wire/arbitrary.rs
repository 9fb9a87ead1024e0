//! Random values for the laws of this crate and of those above it.

use std::fmt::Debug;

use mlswarp::deform::{Coincident, Handle, METHODS, Parameter, Parameters};
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::render::{Canvas, Outside};
use mlswarp::warp::{CanvasSpec, GridSpec, Method, Metric, OutputSpec, RestSpec};
use proptest::prelude::*;

use super::{EnumName, WarpObject};

fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        (-2e6..2e6),
        prop::num::f64::NORMAL | prop::num::f64::ZERO | prop::num::f64::SUBNORMAL
    ]
}

fn place() -> impl Strategy<Value = Point> {
    (coordinate(), coordinate()).prop_map(|(x, y)| Point::new(x, y))
}

fn handle() -> impl Strategy<Value = Handle> {
    let line = prop::collection::vec(place(), 2..5).prop_map(Handle::Polyline);
    prop_oneof![4 => place().prop_map(Handle::Point), 4 => line, 1 => Just(Handle::Missing)]
}

/// Parameters in the objects of methods.
fn own() -> impl Strategy<Value = Parameters> {
    let parameters = METHODS.iter().flat_map(|info| info.parameters);
    let nested: Vec<&Parameter> = parameters.filter(|own| own.object().is_some()).collect();
    let count = nested.len();
    prop::collection::vec(prop::option::of(0.0..=1.0), count).prop_map(move |shares| {
        nested
            .iter()
            .zip(shares)
            .fold(Parameters::default(), |own, (parameter, share)| {
                let most = parameter.least.max(1.0) + 6.0;
                let value = share.map(|t: f64| {
                    let value = parameter.least + t * (parameter.most.min(most) - parameter.least);
                    if parameter.rule.contains("a whole number") {
                        value.round()
                    } else {
                        value
                    }
                });
                own.with_some(parameter.path, value)
            })
    })
}

fn all<T: EnumName + Debug>() -> impl Strategy<Value = T> {
    prop::sample::select(T::ALL)
}

fn rest() -> impl Strategy<Value = RestSpec> {
    let grid = prop_oneof![
        Just(GridSpec::Auto),
        Just(GridSpec::Pixel),
        (1e-9..1e9).prop_map(GridSpec::Cell),
        (0.05..=4.0).prop_map(GridSpec::Tolerance),
        (2_u32.., 2_u32..).prop_map(|(columns, rows)| GridSpec::Counts { columns, rows }),
    ];
    let weights = prop::option::of(prop::collection::vec(1e-9..1e9, 0..5));
    let depth = prop::option::of(prop::collection::vec(1e-9..1e3, 1..5));
    let numbers = (
        prop::option::of(0.5..8.0),
        prop::option::of(1e-3..1e9),
        prop::option::of(0.0..1e9),
        own(),
    );
    let coincident = (all(), 0.0..1e6).prop_map(|(policy, within)| Coincident { policy, within });
    (
        prop::collection::vec(handle(), 0..6),
        (weights, depth),
        all::<Method>(),
        numbers,
        coincident,
        (
            all(),
            grid,
            all(),
            all::<Metric>(),
            prop::option::of(0.0..=1.0),
        ),
    )
        .prop_map(
            |(
                p,
                (weights, depth),
                method,
                (alpha, point_mass, smoothing, own),
                coincident,
                (units, grid, align, metric, mask_threshold),
            )| RestSpec {
                // Who needs no mask has no threshold of one.
                mask_threshold: mask_threshold
                    .filter(|_| metric == Metric::Geodesic || method.info().mesh.is_some()),
                p,
                weights,
                depth,
                method,
                alpha,
                point_mass,
                smoothing,
                own,
                metric,
                mask: None,
                coincident,
                units,
                grid,
                align,
                has_unmatched: false,
            },
        )
}

fn output() -> impl Strategy<Value = OutputSpec> {
    let outside = prop_oneof![
        Just(Outside::Transparent),
        Just(Outside::Edge),
        Just(Outside::Reflect),
        any::<[u8; 4]>().prop_map(Outside::Colour),
        any::<u16>().prop_map(|value| Outside::Value([value; 3])),
        any::<[u16; 3]>().prop_map(Outside::Value)
    ];
    let place = || -1_000_000..=1_000_000;
    let boxes =
        (place(), place(), 1_u32..=2_000_000, 1_u32..=2_000_000).prop_map(|(x, y, w, h)| Canvas {
            x,
            y,
            extent: Extent::new(w, h).expect("at least one pixel"),
        });
    let canvas = prop_oneof![
        Just(CanvasSpec::Same),
        Just(CanvasSpec::Fit),
        boxes.prop_map(CanvasSpec::Box)
    ];
    let output = (
        all(),
        1_u8..=100,
        prop::option::of(all()),
        all(),
        prop::option::of(1_u32..),
        all(),
        outside,
        canvas,
        all(),
    );
    output.prop_map(
        |(format, quality, subsampling, compression, width, filter, outside, canvas, holes)| {
            OutputSpec {
                format,
                quality,
                subsampling,
                compression,
                canvas,
                width,
                filter,
                outside,
                holes,
            }
        },
    )
}

/// Any warp object that the parser may give.
pub(super) fn warp_object() -> impl Strategy<Value = WarpObject> {
    let q = prop::option::of(prop::collection::vec(handle(), 0..6));
    (rest(), q, all(), output()).prop_map(|(rest, q, folds, output)| WarpObject {
        rest,
        q,
        folds,
        output,
        strength: 1.0,
        is_auto: false,
    })
}
