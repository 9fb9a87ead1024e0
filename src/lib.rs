//! mlswarp bends images as if they were real objects: handles `p` are placed on a picture, moved to `q`, and the whole
//! picture follows smoothly (*Image Deformation Using Moving Least Squares*, Schaefer, McPhail, Warren, SIGGRAPH 2006).
//!
//! The modules stand in the order in which a request walks through them; arrows run one way:
//! `service -> warp -> { codec -> pixmap; render -> pixmap, geometry; deform -> geometry }`.

#[forbid(unsafe_code)]
pub mod level;

#[forbid(unsafe_code)]
pub mod geometry;

pub mod deform;

#[forbid(unsafe_code)]
pub mod pixmap;

pub mod render;

pub mod codec;

#[forbid(unsafe_code)]
pub mod warp;

#[forbid(unsafe_code)]
pub mod service;
