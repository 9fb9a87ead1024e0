//! What acknowledgements tell about a connection: its rate, and the time that a frame takes if
//! nothing is in front of it.
//!
//! - **Rate.** A frame's sample is the number of bytes that were acknowledged since the last
//!   acknowledgement before the frame was sent, per time. It never exceeds the rate of the
//!   connection, except by jitter, and reaches it when the connection is never idle. The estimate
//!   is the maximum of the samples of the last [`RATE_MEMORY`].
//! - **Time of a frame.** Without a queue a frame takes a constant latency and its bytes divided by
//!   the rate. The estimate for a frame is the minimum over the frames of the last
//!   [`SAMPLE_AGE`], each of them corrected if it was smaller. Of the frames of about equal size in
//!   each [`SAMPLE_INTERVAL`], the fastest one is kept.
//! - **Rate by size.** While the connection is idle at times, the rate above is too low. Then the
//!   difference between the fastest frames of two sizes shows what a byte takes. It is kept until
//!   there are such frames again.
//! - **Queue.** What a frame takes beyond that has been spent behind other frames.
//!
//! Times are arguments. O(number of kept samples) per frame.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// How long a measured time of a frame counts.
const SAMPLE_AGE: Duration = Duration::from_secs(10);
/// How long a measured rate counts: a rate that falls is noticed in this time.
const RATE_MEMORY: Duration = Duration::from_secs(2);
/// One sample of the time of a frame is kept in each interval of this length, of frames of about
/// equal size.
const SAMPLE_INTERVAL: Duration = Duration::from_millis(200);
/// Maximum numbers of samples: of the rate, and of the time of a frame.
const MAX_RATE_SAMPLES: usize = 64;
const MAX_TIME_SAMPLES: usize = 512;
/// Two frames are compared if the smaller has at most this part of the other's size. Frames whose
/// sizes differ by at most the second part count as equal.
const SMALLER_SIZE_RATIO: f64 = 0.75;
const EQUAL_SIZE_SHARE: f64 = 0.1;
/// Weight of the newest frame in the mean difference.
const NEWEST_WEIGHT: f64 = 1.0 / 16.0;

/// The state of the connection when a frame was sent.
#[derive(Clone, Copy, Debug)]
pub struct SendMark {
    at: Instant,
    bytes: u64,
    delivered: u64,
    delivered_at: Instant,
}

impl SendMark {
    /// When the frame was sent.
    pub const fn at(&self) -> Instant {
        self.at
    }
}

/// What an acknowledged frame says about the connection; times in seconds.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// From sending the frame to its acknowledgement.
    pub took: f64,
    /// The part of it that the frame has spent behind other frames.
    pub queue: f64,
    /// The sending time of the frame at the estimated rate.
    pub frame: f64,
    /// The mean difference between the queues of successive frames: a queue of this length may be
    /// jitter.
    pub jitter: f64,
    /// Sending times of this frame that fit in the time of a frame, at the rate of the newest
    /// sample.
    pub fits: f64,
}

/// The estimate of one connection.
#[derive(Debug, Default)]
pub struct LinkEstimate {
    delivered: u64,
    delivered_at: Option<Instant>,
    /// Rates, bytes per second.
    rates: VecDeque<(Instant, f64)>,
    times: VecDeque<FrameTime>,
    /// The rate by size, bytes per second.
    by_size: Option<f64>,
    queue: f64,
    jitter: f64,
}

/// Seconds and bytes of an acknowledged frame.
#[derive(Clone, Copy, Debug)]
struct FrameTime {
    at: Instant,
    took: f64,
    bytes: f64,
}

impl FrameTime {
    /// The time of a frame of another size. A smaller one is not assumed to be faster: while the
    /// connection is idle at times, the rate is too low, and would explain more than the time of
    /// the larger frame.
    fn of(&self, bytes: f64, rate: f64) -> f64 {
        self.took + (bytes - self.bytes).max(0.0) / rate
    }
}

impl LinkEstimate {
    /// A frame is sent. `is_alone`: every earlier one was acknowledged.
    pub fn sent(&mut self, now: Instant, bytes: u64, is_alone: bool) -> SendMark {
        // After a pause the interval begins when the frame is sent: the pause is not the link's.
        // This is how BBR samples a delivery rate.
        let delivered_at = self.delivered_at.filter(|_| !is_alone).unwrap_or(now);
        SendMark {
            at: now,
            bytes,
            delivered: self.delivered,
            delivered_at,
        }
    }

    /// Frames were acknowledged: the newest of them, and the bytes of all.
    pub fn acknowledged(&mut self, now: Instant, newest: SendMark, bytes: u64) -> Measured {
        self.delivered += bytes;
        self.delivered_at = Some(now);
        let seconds = |from: Instant| now.saturating_duration_since(from).as_secs_f64().max(1e-6);
        let size = newest.bytes.max(1) as f64;
        let sample =
            // Everything that arrived between sending and acknowledging this frame, over that time:
            // a rate, whether one frame was under way or many.
            (self.delivered - newest.delivered).max(1) as f64 / seconds(newest.delivered_at);
        self.rates.push_back((now, sample));
        while self.rates.len() > MAX_RATE_SAMPLES
            || self
                .rates
                .front()
                .is_some_and(|(at, _)| now.saturating_duration_since(*at) > RATE_MEMORY)
        {
            self.rates.pop_front();
        }
        let rate = self
            // The maximum, because an idle link shows too little and no sample can show too much
            // for long.
            .rates
            .iter()
            .fold(sample, |most, (_, rate)| most.max(*rate));
        let time = FrameTime {
            at: now,
            took: seconds(newest.at),
            bytes: size,
        };
        self.keep(time, rate);
        self.by_size = self.compare(size).or(self.by_size);
        let base = self
            // What the fastest frame of the memory would have taken at this size. The excess is
            // time behind other frames, or jitter; the mean difference below tells which.
            .times
            .iter()
            .fold(time.took, |least, kept| least.min(kept.of(size, rate)));
        let queue = time.took - base;
        // The mean deviation of successive frames, as RFC 3550 measures it: a standing queue is
        // long but changes little.
        self.jitter += NEWEST_WEIGHT * ((queue - self.queue).abs() - self.jitter);
        self.queue = queue;
        Measured {
            took: time.took,
            queue,
            jitter: self.jitter,
            frame: size / rate,
            fits: base * sample / size,
        }
    }

    fn keep(&mut self, time: FrameTime, rate: f64) {
        let recent = self
            // One sample for each interval and size: otherwise many small frames would push out the
            // large ones, and the memory of the fastest would be short.
            .times
            .iter_mut()
            .rev()
            .take_while(|kept| time.at.saturating_duration_since(kept.at) < SAMPLE_INTERVAL);
        let mut equal = recent.filter(|kept| {
            kept.bytes.min(time.bytes) > SMALLER_SIZE_RATIO * kept.bytes.max(time.bytes)
        });
        match equal.next() {
            // The time of the interval stays that of its first frame, so that fast frames do not
            // keep an old interval alive for ever.
            Some(kept) if time.took <= kept.of(time.bytes, rate) => {
                *kept = FrameTime {
                    at: kept.at,
                    ..time
                }
            }
            Some(_) => (),
            None => self.times.push_back(time),
        }
        let is_old = |kept: &FrameTime| time.at.saturating_duration_since(kept.at) > SAMPLE_AGE;
        while self.times.len() > MAX_TIME_SAMPLES || self.times.front().is_some_and(is_old) {
            self.times.pop_front();
        }
    }

    /// The rate by the fastest frames of this size and of smaller ones: infinite if they were as
    /// fast.
    fn compare(&self, size: f64) -> Option<f64> {
        let fastest = |least: f64, most: f64| {
            let of_size = self
                .times
                .iter()
                .filter(|kept| kept.bytes >= least && kept.bytes <= most);
            of_size.min_by(|a, b| a.took.total_cmp(&b.took))
        };
        // The difference of two fastest frames contains no latency: what remains is what the bytes
        // took.
        let (small, same) = (
            fastest(0.0, SMALLER_SIZE_RATIO * size)?,
            fastest(
                (1.0 - EQUAL_SIZE_SHARE) * size,
                (1.0 + EQUAL_SIZE_SHARE) * size,
            )?,
        );
        // If the larger one was not slower, bytes cost nothing that can be seen: the rate is as
        // good as infinite.
        Some((same.bytes - small.bytes) / (same.took - small.took).max(1e-9))
    }

    /// Bytes per second that the connection would carry, by both estimates.
    pub fn possible_rate(&self) -> Option<f64> {
        self.rate()
            .map(|rate| rate.max(self.by_size.unwrap_or(0.0)))
    }

    /// Bytes per second that the connection has carried at most; `None` before the first
    /// acknowledgement.
    pub fn rate(&self) -> Option<f64> {
        self.rates
            .iter()
            .map(|(_, rate)| *rate)
            .max_by(f64::total_cmp)
    }

    /// Seconds that a frame of this size takes from sending to its acknowledgement if nothing is in
    /// front of it.
    pub fn frame_time(&self, bytes: u64) -> Option<f64> {
        let rate = self.rate()?;
        self.times
            .iter()
            .map(|kept| kept.of(bytes as f64, rate))
            .min_by(f64::total_cmp)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_samples_is_bounded() {
        let after = |sizes: &[u64]| {
            let mut link = LinkEstimate::default();
            let start = Instant::now();
            for (k, bytes) in (0..20_000_u32).zip(sizes.iter().cycle()) {
                let now = start + k * Duration::from_millis(1);
                let mark = link.sent(now, *bytes, true);
                link.acknowledged(now + Duration::from_micros(500), mark, mark.bytes);
            }
            assert_eq!(link.rates.len(), MAX_RATE_SAMPLES);
            link.times.len()
        };
        // One for each interval and size, whatever the number of frames.
        let intervals = (SAMPLE_AGE.as_millis() / SAMPLE_INTERVAL.as_millis()) as usize;
        assert!((intervals..=intervals + 1).contains(&after(&[1_000])));
        assert!((2 * intervals..=2 * intervals + 2).contains(&after(&[1_000, 100_000])));
        let sizes: Vec<u64> = (6..26).map(|power| 1 << power).collect();
        assert_eq!(after(&sizes), MAX_TIME_SAMPLES);
    }
}
