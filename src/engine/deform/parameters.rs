//! The numbers that a method takes beside handles: what they are, and the ones that are given.

use super::{DeformError, Handles, METHODS};

/// Most parameters that are given at once: a client may send those of all methods, which are then
/// refused because they do not belong together. Those of several methods count as often.
const MAX_PARAMETERS: usize = {
    let (mut count, mut k) = (0, 0);
    while k < METHODS.len() {
        count += METHODS[k].parameters.len();
        k += 1;
    }
    count
};

/// A number that some methods take.
#[derive(Debug)]
pub struct Parameter {
    /// Where it stands in a warp object: `alpha`, or `beier_neely/a` in an object of its method.
    pub path: &'static str,
    /// The least value.
    pub least: f64,
    /// The largest value.
    pub most: f64,
    /// What it must do, in an error: "lie between 0 and 1".
    pub rule: &'static str,
    /// The value if none is given; NaN if it depends on the image.
    pub default: fn(&Handles) -> f64,
    /// What it does, for people.
    pub sentence: &'static str,
}

impl Parameter {
    /// The name in its object.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.path.rsplit('/').next().unwrap_or(self.path)
    }

    /// The object of its method, if it stands in one.
    #[must_use]
    pub fn object(&self) -> Option<&'static str> {
        self.path.split_once('/').map(|(object, _)| object)
    }
}

/// Values of parameters by their path. Equal if the same ones have the same values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Parameters([Option<(&'static str, f64)>; MAX_PARAMETERS]);

impl Parameters {
    /// These with one more, or with another value.
    ///
    /// # Panics
    /// If more are given than all methods have.
    ///
    /// ```
    /// use mlswarp::deform::Parameters;
    /// let given = Parameters::default().with("alpha", 1.5);
    /// assert_eq!((given.get("alpha"), given.get("smoothing")), (Some(1.5), None));
    /// ```
    #[must_use]
    pub fn with(mut self, path: &'static str, value: f64) -> Self {
        let mut given: Vec<_> = self.iter().filter(|(other, _)| *other != path).collect();
        given.push((path, value));
        given.sort_unstable_by_key(|(path, _)| *path);
        self.0 = [None; MAX_PARAMETERS];
        for (place, given) in self.0.iter_mut().zip(&given) {
            *place = Some(*given);
        }
        assert!(given.len() <= MAX_PARAMETERS, "parameters of methods");
        self
    }

    /// These with one more, if there is one.
    #[must_use]
    pub fn with_some(self, path: &'static str, value: Option<f64>) -> Self {
        value.map_or(self, |value| self.with(path, value))
    }

    /// The value of one.
    #[must_use]
    pub fn get(&self, path: &str) -> Option<f64> {
        self.iter()
            .find(|(other, _)| *other == path)
            .map(|(_, value)| value)
    }

    /// All of them, ordered by path.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        self.0.iter().copied().flatten()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0[0].is_none()
    }

    /// The values that hold for these handles: of every parameter in `table` the given one, or its
    /// default.
    pub(super) fn resolved(
        &self,
        table: &'static [Parameter],
        handles: &Handles,
    ) -> Result<Self, DeformError> {
        table
            .iter()
            .try_fold(Self::default(), |resolved, parameter| {
                let Parameter {
                    path,
                    least,
                    most,
                    rule,
                    default,
                    ..
                } = *parameter;
                let value = self.get(path).unwrap_or_else(|| default(handles));
                if !(least..=most).contains(&value) {
                    return Err(DeformError::BadParameter { path, value, rule });
                }
                Ok(resolved.with(path, value))
            })
    }
}
