//! A client that does nothing wrong, while others do.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::photo;
use super::server::form;

/// Answers that are waited for at least.
const MIN_SAMPLES: usize = 10;

/// A client that drags from one connection and must get every answer, until it is told to stop.
pub(crate) struct Healthy {
    stop: Arc<AtomicBool>,
    client: tokio::task::JoinHandle<Vec<Duration>>,
}

impl Healthy {
    pub(crate) async fn begin(address: SocketAddr) -> Self {
        let client = reqwest::Client::new();
        let opened = client
            .post(format!("http://{address}/sessions"))
            .multipart(form(&photo(128, 96), r#"{"p": [[20, 20], [100, 24]]}"#));
        let id = opened.send().await.unwrap().json::<Value>().await.unwrap()["id"]
            .as_str()
            .unwrap()
            .to_owned();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let client = tokio::spawn(async move {
            let mut waits = Vec::new();
            while waits.len() < MIN_SAMPLES || !stopped.load(Ordering::Relaxed) {
                let began = Instant::now();
                let body = json!({"q": [[20 + waits.len() % 9, 20], [100, 24]]});
                let answer = client
                    .post(format!("http://{address}/sessions/{id}/warp"))
                    .json(&body)
                    .send()
                    .await
                    .unwrap();
                assert_eq!(answer.status(), 200);
                assert!(answer.bytes().await.unwrap().starts_with(b"\x89PNG"));
                waits.push(began.elapsed());
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            waits
        });
        Self { stop, client }
    }

    /// Ends it; the time within which 99 of 100 answers came.
    pub(crate) async fn end(self, meanwhile: &str) -> Duration {
        self.stop.store(true, Ordering::Relaxed);
        let mut waits = self.client.await.unwrap();
        waits.sort_unstable();
        let p99 = waits[(waits.len() * 99).div_ceil(100) - 1];
        eprintln!(
            "{meanwhile}: {} answers, p99 {:.1} ms, longest {:.1} ms",
            waits.len(),
            ms(p99),
            ms(waits[waits.len() - 1])
        );
        p99
    }
}

pub(crate) fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
