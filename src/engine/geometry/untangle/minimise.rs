//! The method of limited memory by Broyden, Fletcher, Goldfarb and Shanno (Nocedal 1980).

use super::Vec2;

/// Steps whose change of slope is remembered.
const REMEMBERED: usize = 10;
const ITERATIONS: u32 = 60;
/// Halvings of a step that does not gain.
const HALVINGS: u32 = 20;
/// The least gain of a step, as a share of what its slope promises.
const LEAST_GAIN: f64 = 1e-4;
/// A step that gains less than this share of the energy is the last one.
const MENDED_DETERMINANT: f64 = 1e-9;
/// The length of the first step, px.
const FIRST_STEP: f64 = 0.5;

/// A step, the change of slope along it, and the inverse of their product.
struct Remembered {
    step: Vec<Vec2>,
    change: Vec<Vec2>,
    inverse: f64,
}

/// Computes an energy at a position, and its slope.
type Energy<'a> = &'a mut dyn FnMut(&[Vec2], &mut [Vec2]) -> f64;

/// Moves `x` to a lower energy; returns that, and how often it was computed, at most about `spare`
/// times. `None` when cancelled.
pub(super) fn minimise(
    energy: Energy<'_>,
    x: &mut [Vec2],
    spare: u32,
    cancelled: &dyn Fn() -> bool,
) -> Option<(f64, u32)> {
    let mut slope = vec![Vec2::ZERO; x.len()];
    let (mut lowest, mut spent) = (energy(x, &mut slope), 1);
    let mut memory: Vec<Remembered> = Vec::new();
    let (mut next, mut next_slope) = (x.to_vec(), slope.clone());
    for _ in 0..ITERATIONS {
        let direction = direction(&slope, &memory);
        let descent = dot(&slope, &direction);
        let (mut length, mut gained) = (1.0, 0.0);
        for _ in 0..HALVINGS {
            if cancelled() {
                return None;
            }
            for ((next, x), d) in next.iter_mut().zip(&*x).zip(&direction) {
                *next = *x + *d * length;
            }
            let found = energy(&next, &mut next_slope);
            spent += 1;
            if found <= lowest + LEAST_GAIN * length * descent {
                (gained, lowest) = (lowest - found, found);
                break;
            }
            length *= 0.5;
        }
        if gained <= 0.0 {
            break;
        }
        let step: Vec<Vec2> = direction.iter().map(|d| *d * length).collect();
        let pairs = next_slope.iter().zip(&slope);
        let change: Vec<Vec2> = pairs.map(|(next, slope)| *next - *slope).collect();
        let product = dot(&step, &change);
        if product > 1e-12 * dot(&change, &change) {
            memory.push(Remembered {
                step,
                change,
                inverse: 1.0 / product,
            });
            if memory.len() > REMEMBERED {
                memory.remove(0);
            }
        }
        x.copy_from_slice(&next);
        slope.copy_from_slice(&next_slope);
        if gained <= MENDED_DETERMINANT * lowest.abs() || spent >= spare {
            break;
        }
    }
    Some((lowest, spent))
}

/// Where the energy falls, by what is remembered of its curvature.
fn direction(slope: &[Vec2], memory: &[Remembered]) -> Vec<Vec2> {
    let mut d: Vec<Vec2> = slope.iter().map(|v| -*v).collect();
    let Some(last) = memory.last() else {
        let length = dot(&d, &d).sqrt();
        if length > FIRST_STEP {
            scale(&mut d, FIRST_STEP / length);
        }
        return d;
    };
    let mut shares = Vec::with_capacity(memory.len());
    for old in memory.iter().rev() {
        let share = old.inverse * dot(&old.step, &d);
        add(&mut d, &old.change, -share);
        shares.push(share);
    }
    scale(
        &mut d,
        1.0 / (last.inverse * dot(&last.change, &last.change)),
    );
    for (old, share) in memory.iter().zip(shares.iter().rev()) {
        let back = old.inverse * dot(&old.change, &d);
        add(&mut d, &old.step, share - back);
    }
    d
}

/// Several sums side by side: one alone would wait for each of its additions.
fn dot(a: &[Vec2], b: &[Vec2]) -> f64 {
    const SUMS: usize = 8;
    let (in_a, in_b) = (a.chunks_exact(SUMS), b.chunks_exact(SUMS));
    let rest = in_a.remainder().iter().zip(in_b.remainder());
    let rest: f64 = rest.map(|(a, b)| a.dot(*b)).sum();
    let mut sums = [0.0; SUMS];
    for (a, b) in in_a.zip(in_b) {
        for k in 0..SUMS {
            sums[k] += a[k].dot(b[k]);
        }
    }
    rest + sums.iter().sum::<f64>()
}

fn scale(a: &mut [Vec2], by: f64) {
    a.iter_mut().for_each(|a| *a = *a * by);
}

fn add(a: &mut [Vec2], b: &[Vec2], times: f64) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += *b * times;
    }
}
