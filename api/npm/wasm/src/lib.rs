//! The engine for JavaScript, without imports: functions that take and return numbers.
//!
//! JavaScript holds every object by its number; 0 stands for none, and for failure: then [`error`]
//! has the problem document. Bytes go in and out through buffers: [`buffer`] makes one of a length,
//! [`address`] says where it lies in the memory, and a function that is given its number takes it.
//! Positions are little-endian f64, those of meshes and maps f32. No pointer is ever taken from
//! JavaScript, so no number that it passes can do more than fail.
//!
//! A panic ends the instance; its text stays readable ([`panic_address`]).

#![allow(unsafe_code, reason = "exported names; nothing else is unsafe")]

mod blend;
mod file;
mod objects;
mod subject;

use std::sync::{Arc, Mutex};

use mlswarp::warp::{Image, LabelImage, MapDirection};
use mlswarp::{PosedWarp, Warper};
use mlswarp_contract::blend::Blend;

use objects::{Object, bytes, get, give, result, with};

/// The version of these functions. JavaScript of another one refuses to work with this file.
const ABI_VERSION: u32 = 3;

/// The text of the panic that ended this instance.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// The version of these functions. Keeps the text of a later panic.
#[unsafe(no_mangle)]
pub extern "C" fn abi_version() -> u32 {
    std::panic::set_hook(Box::new(|panic| {
        if let Ok(mut text) = PANIC.lock() {
            text.clear();
            // A release does not say where it was: the trap's stack does.
            let said = panic.payload();
            let literal = said.downcast_ref::<&str>().copied();
            text.push_str(
                literal
                    .or_else(|| said.downcast_ref().map(String::as_str))
                    .unwrap_or("a panic"),
            );
        }
    }));
    ABI_VERSION
}

/// Where the text of a panic lies; it is UTF-8.
#[unsafe(no_mangle)]
pub extern "C" fn panic_address() -> usize {
    PANIC
        .lock()
        .map_or(0, |text| text.as_ptr().expose_provenance())
}

/// The bytes of that text; 0 without a panic.
#[unsafe(no_mangle)]
pub extern "C" fn panic_length() -> usize {
    PANIC.lock().map_or(0, |text| text.len())
}

/// Panics. For tests: what JavaScript makes of it.
#[unsafe(no_mangle)]
pub extern "C" fn panic_for_tests() {
    panic!("a panic for tests");
}

/// A buffer of zeros; 0 if there is too little memory.
#[unsafe(no_mangle)]
pub extern "C" fn buffer(length: usize) -> u32 {
    result(|| objects::zeros(length).map(Object::Buffer))
}

/// Where a buffer lies, until the next call of any function but this one and [`length`]; 0 if the
/// number is not one of a buffer.
#[unsafe(no_mangle)]
pub extern "C" fn address(number: u32) -> usize {
    with::<Vec<u8>, _>(number, |bytes| bytes.as_ptr().expose_provenance()).unwrap_or(0)
}

/// The bytes of a buffer.
#[unsafe(no_mangle)]
pub extern "C" fn length(number: u32) -> usize {
    with::<Vec<u8>, _>(number, Vec::len).unwrap_or(0)
}

/// Lets go of an object. What was made of it stays.
#[unsafe(no_mangle)]
pub extern "C" fn free(number: u32) {
    objects::take(number);
}

/// The number of objects that JavaScript has not let go of.
#[unsafe(no_mangle)]
pub extern "C" fn objects() -> usize {
    objects::count()
}

/// A buffer with the last problem, as JSON; 0 if there was none since the last call.
#[unsafe(no_mangle)]
pub extern "C" fn error() -> u32 {
    objects::last_problem().map_or(0, |problem| {
        give(Object::Buffer(
            problem.to_json("", None).to_string().into_bytes(),
        ))
    })
}

/// Handles at rest on an image of a size. `warp`: a warp object, whose `q` only `method: auto`
/// needs. `outline`: what handles can act through, or 0.
#[unsafe(no_mangle)]
pub extern "C" fn plan(warp: u32, width: u32, height: u32, outline: u32) -> u32 {
    result(|| {
        let warp = bytes(warp)?;
        let outline = (outline != 0).then(|| get(outline)).transpose()?;
        let plan = file::plan(&warp, [width, height], outline.as_deref())?;
        Ok(Object::Plan(Box::new(plan)))
    })
}

/// What is visible of an image: that of a file, or one that is held. `region`: such a mask, or 0.
#[unsafe(no_mangle)]
pub extern "C" fn outline(image: u32, region: u32) -> u32 {
    result(|| {
        let image = file::image(image)?;
        let region = (region != 0).then(|| file::image(region)).transpose()?;
        file::outline(image, region.as_deref()).map(|outline| Object::Outline(Box::new(outline)))
    })
}

/// A pose of a plan. `pose`: `{"q", "strength"?}`.
#[unsafe(no_mangle)]
pub extern "C" fn pose(plan: u32, pose: u32) -> u32 {
    result(|| {
        let plan = get::<Warper>(plan)?;
        file::pose(&plan, &bytes(pose)?).map(|pose| Object::Pose(Box::new(pose)))
    })
}

/// A buffer with `{"folds", "mirrored", "residual", "exceeded", "warnings"}` of a pose.
#[unsafe(no_mangle)]
pub extern "C" fn report(pose: u32) -> u32 {
    result(|| {
        let report = file::report(get::<PosedWarp>(pose)?.report());
        Ok(Object::Buffer(report.to_string().into_bytes()))
    })
}

/// An image of RGBA bytes, whose alpha is not premultiplied.
#[unsafe(no_mangle)]
pub extern "C" fn image(pixels: u32, width: u32, height: u32) -> u32 {
    result(|| {
        let image = Image::from_rgba8(width, height, bytes(pixels)?);
        Ok(Object::Image(Arc::new(image?)))
    })
}

/// Labels of 8, 16 or 32 bits, little-endian.
#[unsafe(no_mangle)]
pub extern "C" fn labels(values: u32, width: u32, height: u32, bits: u32) -> u32 {
    result(|| {
        let labels = subject::labels(&bytes(values)?, [width, height], bits)?;
        Ok(Object::Labels(Box::new(labels)))
    })
}

/// Draws an image, labels or, for 0, how much of each pixel is covered. `warp`: a warp object whose
/// `output` counts. The result: a buffer with width, height and the number of another (u32), which
/// has the samples, as many for a pixel as the subject has.
#[unsafe(no_mangle)]
pub extern "C" fn draw(pose: u32, subject: u32, warp: u32) -> u32 {
    result(|| {
        let pose = get::<PosedWarp>(pose)?;
        let output = file::output(&bytes(warp)?)?;
        let drawn = if subject == 0 {
            subject::drawn(pose.render_coverage(), output)
        } else if let Ok(labels) = get::<LabelImage>(subject) {
            subject::drawn_labels(&pose, &labels, output)
        } else {
            subject::drawn(pose.render(&*get::<Image>(subject)?)?, output)
        };
        drawn.map(Object::Buffer)
    })
}

/// A blend. `images`: the numbers (u32) of its images; `blend`: the object of `POST /blend`, in
/// which every image has its number among them and its handles.
#[unsafe(no_mangle)]
pub extern "C" fn blend(images: u32, blend: u32) -> u32 {
    result(|| {
        let blend = blend::of(&bytes(images)?, &bytes(blend)?)?;
        Ok(Object::Blend(Box::new(blend)))
    })
}

/// The number of results of a blend.
#[unsafe(no_mangle)]
pub extern "C" fn frames(blend: u32) -> usize {
    with::<Blend, _>(blend, Blend::frames).unwrap_or(0)
}

/// A buffer with width, height and the bytes of a report (u32), that report, and the RGBA bytes of
/// a frame.
#[unsafe(no_mangle)]
pub extern "C" fn frame(blend: u32, index: usize) -> u32 {
    result(|| blend::frame(&*get::<Blend>(blend)?, index).map(Object::Buffer))
}

/// A buffer with as many positions as `positions` has; NaN where nothing maps.
#[unsafe(no_mangle)]
pub extern "C" fn points(pose: u32, positions: u32, is_inverse: u32) -> u32 {
    result(|| {
        let pose = get::<PosedWarp>(pose)?;
        let positions = subject::positions(&bytes(positions)?);
        let mapped: Vec<[f64; 2]> = if is_inverse == 0 {
            pose.map_points(&positions)?
        } else {
            let found = pose.unmap_points(&positions)?.into_iter();
            found.map(|place| place.unwrap_or([f64::NAN; 2])).collect()
        };
        let bytes = mapped.as_flattened().iter().flat_map(|x| x.to_le_bytes());
        Ok(Object::Buffer(bytes.collect()))
    })
}

/// A buffer with a position (f32) for every pixel of the image: of the source, or, forwards, of the
/// result.
#[unsafe(no_mangle)]
pub extern "C" fn map(pose: u32, is_forward: u32) -> u32 {
    result(|| {
        let direction = if is_forward == 0 {
            MapDirection::Inverse
        } else {
            MapDirection::Forward
        };
        let map = get::<PosedWarp>(pose)?.map(direction)?;
        let bytes = map.as_flattened().iter().flat_map(|x| x.to_le_bytes());
        Ok(Object::Buffer(bytes.collect()))
    })
}

/// A buffer with the columns and rows of vertices (u32) and their posed positions (f32).
#[unsafe(no_mangle)]
pub extern "C" fn mesh(pose: u32) -> u32 {
    result(|| {
        let pose = get::<PosedWarp>(pose)?;
        let grid = pose.mesh().grid();
        let mut bytes = [grid.columns().to_le_bytes(), grid.rows().to_le_bytes()].concat();
        bytes.extend(pose.posed_mesh().to_le_bytes(&|| false)?);
        Ok(Object::Buffer(bytes))
    })
}

/// A buffer with the bytes of a report (u32), the report and the file that `POST /warp` sends for
/// this file and this warp object. `region`: a mask, or 0. With `is_gif` it is a frame of an
/// animated GIF.
#[unsafe(no_mangle)]
pub extern "C" fn warp_file(file: u32, warp: u32, region: u32, is_gif: u32) -> u32 {
    result(|| {
        let region = if region == 0 {
            None
        } else {
            Some(bytes(region)?)
        };
        let (file, warp) = (bytes(file)?, bytes(warp)?);
        file::warp(&file, &warp, region.as_deref(), is_gif != 0).map(Object::Buffer)
    })
}

/// A buffer with the warp object that `POST /landmarks` makes of landmark files. `p` and `q`: a
/// file with both sides and 0, or one for each side. `options`: `{"match"?, "item"?}`.
#[unsafe(no_mangle)]
pub extern "C" fn landmarks(options: u32, p: u32, q: u32) -> u32 {
    result(|| {
        let q = if q == 0 { None } else { Some(bytes(q)?) };
        file::landmarks(&bytes(options)?, bytes(p)?, q).map(Object::Buffer)
    })
}
