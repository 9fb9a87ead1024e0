//! What identifies a method: keys of caches and digests of rest handles are in the caches and the
//! answers of programs that run now, so they stay equal, and no two methods share one.

use std::sync::Arc;

use super::super::{Digest, Limits, Method, ResolvedRest, RestMask, RestSpec};
use crate::deform::{AcceptedHandles, Handle, METHODS, MethodInfo};
use crate::geometry::Point;
use crate::pixmap::Extent;
use crate::topology::{Mask, Membership};

fn points() -> Vec<Handle> {
    [(10.5, 20.0), (80.0, 25.0), (40.0, 70.25), (60.0, 55.0)]
        .map(|(x, y)| Handle::Point(Point::new(x, y)))
        .to_vec()
}

fn lines() -> Vec<Handle> {
    let line = |places: &[(f64, f64)]| {
        Handle::Polyline(places.iter().map(|&(x, y)| Point::new(x, y)).collect())
    };
    vec![
        line(&[(10.0, 20.0), (50.0, 25.0), (55.0, 60.0)]),
        line(&[(70.0, 80.0), (90.0, 30.0)]),
    ]
}

fn of_set(name: &str) -> Vec<Handle> {
    match name {
        "points" => points(),
        "lines" => lines(),
        "line" => [10.0, 20.0, 50.0]
            .map(|x| Handle::Point(Point::new(x, x)))
            .to_vec(),
        _ => [points(), lines()].concat(),
    }
}

/// A mask of the whole image.
fn everything() -> RestMask {
    let row = |_, row: &mut [Membership]| row.fill(Membership::Inside);
    RestMask {
        mask: Arc::new(Mask::new(120, 90, row, &|| false).unwrap()),
        digest: Digest::of(b"everything"),
    }
}

fn digests(rest: &RestSpec) -> [String; 2] {
    let extent = Extent::new(120, 90).unwrap();
    let setup = ResolvedRest::new(rest, extent, &Limits::default(), &|| false).unwrap();
    [setup.plan_key(), setup.rest_digest()].map(|digest| digest.to_string()[..16].to_owned())
}

/// Each set and method with the first digits of its plan key and of its rest digest.
const PINNED: [(&str, Method, &str, &str); 22] = [
    (
        "points",
        Method::Rigid,
        "4fbd0c08bed787c7",
        "787dc38805dfdc22",
    ),
    (
        "points",
        Method::Similarity,
        "8d709bbc037e1fd3",
        "a94d931348827708",
    ),
    (
        "points",
        Method::Affine,
        "52bbefd7c0b3805e",
        "e096ab08b586c1e3",
    ),
    (
        "points",
        Method::ThinPlateSpline,
        "d7cb3013a18a2eb6",
        "b55c083bfdfd42b9",
    ),
    (
        "points",
        Method::GlobalAffine,
        "ac993433f57d2f7e",
        "cfc44ff31c7ea220",
    ),
    (
        "lines",
        Method::Rigid,
        "39fcee903966e201",
        "f58676c424a5f26a",
    ),
    (
        "lines",
        Method::Similarity,
        "7908da830edb3493",
        "ce22031051ad9610",
    ),
    (
        "lines",
        Method::Affine,
        "caf89fdb82bc3ddb",
        "5021d5d9af4781dc",
    ),
    (
        "lines",
        Method::GlobalAffine,
        "30c7dfd8c81b2b5f",
        "6b0dc7d7ae5706d4",
    ),
    (
        "mixed",
        Method::Rigid,
        "7f3e6936401104a0",
        "4c5724a6b19db5bd",
    ),
    (
        "mixed",
        Method::Similarity,
        "d5f5f982c5812d2a",
        "2f82496adc28a595",
    ),
    (
        "mixed",
        Method::Affine,
        "1cc368496b86e0f0",
        "d3b9d04a8c71fd27",
    ),
    (
        "mixed",
        Method::GlobalAffine,
        "2a5346adb51ec227",
        "8b98a01039fc7e46",
    ),
    (
        "line",
        Method::Rigid,
        "c2bc8bcb880b557a",
        "cb2d521c01f82456",
    ),
    (
        "line",
        Method::Similarity,
        "3472ffedd3b7d452",
        "72d1361cbaccf1da",
    ),
    (
        "line",
        Method::Affine,
        "3472ffedd3b7d452",
        "72d1361cbaccf1da",
    ),
    (
        "line",
        Method::ThinPlateSpline,
        "a9a646c6b6184b28",
        "1c6c7e21aee3bf28",
    ),
    (
        "line",
        Method::GlobalAffine,
        "0385c18daced19fd",
        "83421e83e13186cc",
    ),
    (
        "given",
        Method::Affine,
        "80116840b249c55c",
        "cd414b41f223f2fe",
    ),
    (
        "given",
        Method::Rigid,
        "711b3dbfa2fba347",
        "2bdd6349d7e3fe77",
    ),
    (
        "given",
        Method::ThinPlateSpline,
        "0b6689762a46cd39",
        "0a5272345a31505b",
    ),
    (
        "given",
        Method::GlobalAffine,
        "5c72669c07658f60",
        "f977dfabcdd2f37a",
    ),
];

#[test]
fn keys_and_digests_of_methods_are_those_of_former_versions() {
    for (name, method, plan, digest) in PINNED {
        let (alpha, point_mass, smoothing) = match (name, method) {
            ("given", Method::Affine) => (Some(1.5), None, None),
            ("given", Method::Rigid) => (Some(2.0), Some(3.0), None),
            ("given", Method::ThinPlateSpline) => (None, None, Some(0.1)),
            ("given", _) => (None, Some(2.5), None),
            _ => (None, None, None),
        };
        let is_spline = method == Method::ThinPlateSpline;
        let rest = RestSpec {
            p: of_set(if is_spline && name == "given" {
                "points"
            } else {
                name
            }),
            method,
            alpha,
            point_mass,
            smoothing,
            ..RestSpec::default()
        };
        assert_eq!(digests(&rest), [plan, digest], "{name} {method:?}");
    }
}

#[test]
fn no_two_methods_share_a_key_or_a_digest() {
    for (name, handles) in [
        ("points", AcceptedHandles::Points),
        ("lines", AcceptedHandles::Lines),
    ] {
        let takes = |info: &&&MethodInfo| [AcceptedHandles::All, handles].contains(&info.handles);
        let of = |info: &&MethodInfo| {
            digests(&RestSpec {
                p: of_set(name),
                method: info.method,
                mask: info.mesh.is_some().then(everything),
                ..RestSpec::default()
            })
        };
        let mut all: Vec<[String; 2]> = METHODS.iter().filter(takes).map(of).collect();
        for k in 0..2 {
            all.sort_by(|a, b| a[k].cmp(&b[k]));
            assert!(
                all.windows(2).all(|pair| pair[0][k] != pair[1][k]),
                "{name} {all:?}"
            );
        }
    }
}

#[test]
fn a_mask_is_part_of_key_and_digest() {
    let with = |name: Option<&[u8]>| {
        let mask =
            Arc::new(Mask::new(1, 1, |_, row| row.fill(Membership::Inside), &|| false).unwrap());
        digests(&RestSpec {
            p: points(),
            mask: name.map(|name| RestMask {
                mask,
                digest: Digest::of(name),
            }),
            ..RestSpec::default()
        })
    };
    let all = [with(None), with(Some(b"one")), with(Some(b"another"))];
    assert_eq!(all[1], with(Some(b"one")));
    let [none, one, another] = &all;
    let differ = |[a, b]: &[String; 2], [c, d]: &[String; 2]| a != c && b != d;
    assert!(differ(none, one) && differ(one, another) && differ(none, another));
}
