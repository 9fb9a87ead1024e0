//! What JavaScript holds by number.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

use mlswarp::warp::{Image, LabelImage, Region};
use mlswarp::{PosedWarp, Warper};
use mlswarp_contract::blend::Blend;
use mlswarp_contract::problem::{Code, Problem};

/// What an image shows: an image, and the region of it that moves.
pub(crate) struct Outline {
    pub(crate) image: Arc<Image>,
    pub(crate) region: Option<Region>,
}

/// What a number stands for.
pub(crate) enum Object {
    Blend(Box<Blend>),
    Buffer(Vec<u8>),
    Plan(Box<Warper>),
    Pose(Box<PosedWarp>),
    Image(Arc<Image>),
    Outline(Box<Outline>),
    Labels(Box<LabelImage>),
}

/// A kind of object.
pub(crate) trait Kind: Sized {
    const NAME: &str;
    fn of(object: &Object) -> Option<&Self>;
}

macro_rules! kinds {
    ($($kind:ty: $variant:ident $name:literal),+ $(,)?) => {$(
        impl Kind for $kind {
            const NAME: &str = $name;
            fn of(object: &Object) -> Option<&Self> {
                match object {
                    Object::$variant(value) => Some(value),
                    _ => None,
                }
            }
        }
    )+};
}

kinds! {
    Vec<u8>: Buffer "buffer",
    Warper: Plan "plan",
    PosedWarp: Pose "pose",
    Image: Image "image",
    Outline: Outline "outline",
    LabelImage: Labels "label image",
    Blend: Blend "blend",
}

#[derive(Default)]
struct Objects {
    /// An object has its place plus 1 as number.
    places: Vec<Option<Rc<Object>>>,
    vacant: Vec<usize>,
    problem: Option<Problem>,
}

thread_local! {
    static OBJECTS: RefCell<Objects> = RefCell::default();
}

/// An image, shared.
/// Errors: No such object, or one of another kind.
pub(crate) fn image(number: u32) -> Result<Arc<Image>, Problem> {
    let object = get::<Image>(number)?.object;
    match &*object {
        Object::Image(image) => Ok(Arc::clone(image)),
        _ => unreachable!("its kind was checked"),
    }
}

/// An object in use: it stays while it is.
pub(crate) struct InUse<T> {
    object: Rc<Object>,
    kind: std::marker::PhantomData<T>,
}

impl<T: Kind> std::ops::Deref for InUse<T> {
    type Target = T;

    fn deref(&self) -> &T {
        T::of(&self.object).expect("it was checked")
    }
}

/// Its number.
pub(crate) fn give(object: Object) -> u32 {
    OBJECTS.with_borrow_mut(|objects| {
        let place = objects.vacant.pop().unwrap_or_else(|| {
            objects.places.push(None);
            objects.places.len() - 1
        });
        objects.places[place] = Some(Rc::new(object));
        u32::try_from(place + 1).expect("fewer objects than bytes")
    })
}

fn find(number: u32) -> Option<Rc<Object>> {
    let place = (number as usize).checked_sub(1)?;
    OBJECTS.with_borrow(|objects| objects.places.get(place)?.clone())
}

/// Errors: No such object, or one of another kind.
pub(crate) fn get<T: Kind>(number: u32) -> Result<InUse<T>, Problem> {
    find(number)
        .filter(|object| T::of(object).is_some())
        .map(|object| InUse {
            object,
            kind: std::marker::PhantomData,
        })
        .ok_or_else(|| {
            let detail = format!("{number} is the number of no {}", T::NAME);
            Problem::new(Code::BadValue, detail)
        })
}

/// What `read` makes of an object; `None` if there is none of this kind.
pub(crate) fn with<T: Kind, R>(number: u32, read: impl FnOnce(&T) -> R) -> Option<R> {
    find(number).as_deref().and_then(T::of).map(read)
}

/// Lets go of an object.
pub(crate) fn take(number: u32) -> Option<Rc<Object>> {
    let place = (number as usize).checked_sub(1)?;
    OBJECTS.with_borrow_mut(|objects| {
        let object = objects.places.get_mut(place)?.take();
        if object.is_some() {
            objects.vacant.push(place);
        }
        object
    })
}

/// The objects that are held.
pub(crate) fn count() -> usize {
    OBJECTS.with_borrow(|objects| objects.places.len() - objects.vacant.len())
}

/// The bytes of a buffer, which is let go of.
/// Errors: No such buffer.
pub(crate) fn bytes(number: u32) -> Result<Vec<u8>, Problem> {
    let buffer = get::<Vec<u8>>(number)?.object;
    take(number);
    match Rc::try_unwrap(buffer) {
        Ok(Object::Buffer(bytes)) => Ok(bytes),
        Ok(_) | Err(_) => Err(Problem::new(Code::BadValue, "a buffer is in use")),
    }
}

/// The number of what is made; 0 for a problem, which is kept.
pub(crate) fn result(make: impl FnOnce() -> Result<Object, Problem>) -> u32 {
    match make() {
        Ok(object) => give(object),
        Err(problem) => {
            OBJECTS.with_borrow_mut(|objects| objects.problem = Some(problem));
            0
        }
    }
}

/// The last problem, once.
pub(crate) fn last_problem() -> Option<Problem> {
    OBJECTS.with_borrow_mut(|objects| objects.problem.take())
}

/// Zeros.
/// Errors: Too little memory.
pub(crate) fn zeros(length: usize) -> Result<Vec<u8>, Problem> {
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(length).map_err(|_| {
        let detail = format!("there is too little memory for {length} bytes");
        Problem::new(Code::Overloaded, detail)
    })?;
    bytes.resize(length, 0);
    Ok(bytes)
}
