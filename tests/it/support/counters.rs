//! What a service has counted, as its metrics say it.

use mlswarp_server::app::{App, metrics_text};

/// Counters since the start of a service.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counters {
    pub(crate) plans_built: u64,
    pub(crate) images_decoded: u64,
    pub(crate) pictures_begun: u64,
    pub(crate) pictures_finished: u64,
    pub(crate) pictures_abandoned: u64,
    /// Requests answered 409 because of a newer pose.
    pub(crate) superseded: u64,
    pub(crate) sockets_open: u64,
    pub(crate) frames_sent: u64,
    /// Poses of drag sockets that were replaced by newer ones before their frame was sent.
    pub(crate) poses_superseded: u64,
}

pub(crate) trait Counted {
    fn counters(&self) -> Counters;
}

impl Counted for App {
    fn counters(&self) -> Counters {
        let text = metrics_text::text(self);
        let read = |name: &str| -> u64 {
            let line = text
                .lines()
                .find_map(|line| line.strip_prefix(name))
                .unwrap_or_else(|| panic!("no {name}"));
            line.trim().parse().unwrap()
        };
        Counters {
            plans_built: read("mlswarp_cache_builds_total{cache=\"plans\"}"),
            images_decoded: read("mlswarp_cache_builds_total{cache=\"images\"}"),
            pictures_begun: read("mlswarp_pictures_total{state=\"started\"}"),
            pictures_finished: read("mlswarp_pictures_total{state=\"finished\"}"),
            pictures_abandoned: read("mlswarp_pictures_total{state=\"abandoned\"}"),
            superseded: read("mlswarp_superseded_total{by=\"request\"}"),
            sockets_open: read("mlswarp_sockets "),
            frames_sent: read("mlswarp_frames_sent_total "),
            poses_superseded: read("mlswarp_superseded_total{by=\"socket\"}"),
        }
    }
}
