//! The process is killed while clients upload, replace, delete and drag; what was answered before
//! is there after it has been started again, and what was answered to be gone is gone. Where a
//! request was under way, either is right.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use reqwest::{Client, Method, RequestBuilder};
use serde_json::{Value, json};

use crate::support::picture::{Decoded, decoded};
use crate::support::program::Program;
use crate::support::redis::Redis;
use crate::support::server::form;
use crate::support::{Scratch, is_full, photo};

const CLIENTS: u64 = 4;
/// Sessions that one client keeps.
const SESSIONS: usize = 6;

/// Picture, handles and layer of a session that is there.
type State = Option<(usize, Value, Option<usize>)>;

/// What may be found of each session: one state, or two where nobody was told.
type Book = HashMap<String, Vec<State>>;

struct Picture {
    file: Vec<u8>,
    pixels: Decoded,
    /// Files of its size.
    layers: Vec<Vec<u8>>,
}

fn pictures() -> Arc<Vec<Picture>> {
    let picture = |k: u32| {
        let file = photo(40 + 4 * k, 30 + k);
        let layer = |n: u8| {
            let mut file = std::io::Cursor::new(Vec::new());
            let grey = image::GrayImage::from_fn(40 + 4 * k, 30 + k, |x, y| {
                image::Luma([(x ^ y) as u8 + n])
            });
            grey.write_to(&mut file, image::ImageFormat::Png).unwrap();
            file.into_inner()
        };
        Picture {
            pixels: decoded(&file),
            file,
            layers: (0..3).map(layer).collect(),
        }
    };
    Arc::new((0..8).map(picture).collect())
}

/// Enough chance for a test (splitmix64).
struct Dice(u64);

impl Dice {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n as u64) as usize
    }

    fn handles(&mut self) -> Value {
        (0..=self.below(3))
            .map(|k| json!([5.0 + 9.0 * k as f64, 4.0 + self.below(20) as f64]))
            .collect()
    }
}

/// Asks until the server dies; `true` when it answered that it did as asked. Refusals for want of
/// the store are no answer.
async fn answered(
    request: RequestBuilder,
    expected: &[u16],
) -> Result<Option<Value>, reqwest::Error> {
    let response = request.send().await?;
    let status = response.status().as_u16();
    let body = response.bytes().await?;
    if status == 503 {
        return Ok(None);
    }
    assert!(
        expected.contains(&status),
        "{status}: {}",
        String::from_utf8_lossy(&body)
    );
    Ok(Some(serde_json::from_slice(&body).unwrap_or_default()))
}

/// One client: works on its own sessions until the server is gone.
async fn client(
    base: String,
    pictures: Arc<Vec<Picture>>,
    mut book: Book,
    mut dice: Dice,
    asked: Arc<AtomicU64>,
) -> Book {
    let http = Client::builder()
        .timeout(Duration::from_secs(30))
        .build()
        .unwrap();
    loop {
        asked.fetch_add(1, Ordering::Relaxed);
        let picture = dice.below(pictures.len());
        let p = dice.handles();
        let warp = json!({"p": p}).to_string();
        let sessions = format!("{base}/sessions");
        // Sessions of which it is certain what they are.
        let mut known: Vec<(String, State)> = book
            .iter()
            .filter(|(_, states)| states.len() == 1)
            .map(|(id, states)| (id.clone(), states[0].clone()))
            .collect();
        known.sort_by(|a, b| a.0.cmp(&b.0));
        let some = (!known.is_empty()).then(|| known.swap_remove(dice.below(known.len())));
        let living = known.iter().filter(|(_, state)| state.is_some()).count();
        let (id, new, request, expected): (String, State, RequestBuilder, &[u16]) =
            match (dice.below(13), some) {
                (0 | 1, Some((id, Some(_)))) => (
                    id.clone(),
                    None,
                    http.delete(format!("{sessions}/{id}")),
                    &[204],
                ),
                (_, Some((id, Some(_)))) if living >= SESSIONS => (
                    id.clone(),
                    None,
                    http.delete(format!("{sessions}/{id}")),
                    &[204],
                ),
                (2 | 3, Some((id, Some((old, _, layer))))) => {
                    let request = http
                        .request(Method::PUT, format!("{sessions}/{id}/handles"))
                        .json(&json!({"p": p}));
                    (id, Some((old, p, layer)), request, &[200])
                }
                (10 | 11, Some((id, Some((old, p, _))))) => {
                    let layer = dice.below(3);
                    let request = http
                        .request(Method::PUT, format!("{sessions}/{id}/layers/x"))
                        .body(pictures[old].layers[layer].clone());
                    (id, Some((old, p, Some(layer))), request, &[200, 201])
                }
                (12, Some((id, Some((old, p, Some(_)))))) => {
                    let request = http.delete(format!("{sessions}/{id}/layers/x"));
                    (id, Some((old, p, None)), request, &[204])
                }
                (4 | 5, Some((id, state @ Some(_)))) => {
                    let handles = state.as_ref().map(|(_, handles, _)| handles.clone());
                    let request = http
                        .post(format!("{sessions}/{id}/warp"))
                        .json(&json!({"q": handles}));
                    (id, state, request, &[200])
                }
                (6, _) => {
                    let request = http
                        .post(&sessions)
                        .multipart(form(&pictures[picture].file, warp));
                    match answered(request, &[201]).await {
                        Ok(Some(made)) => drop(book.insert(
                            made["id"].as_str().unwrap().to_owned(),
                            vec![Some((picture, p, None))],
                        )),
                        Ok(None) => {}
                        Err(_) => return book,
                    }
                    continue;
                }
                (_, some) => {
                    let new_name = || (uuid::Uuid::new_v4().to_string(), None);
                    let (id, old) = some.filter(|_| dice.below(2) == 0).unwrap_or_else(new_name);
                    let request = http
                        .request(Method::PUT, format!("{sessions}/{id}"))
                        .multipart(form(&pictures[picture].file, warp));
                    // The same upload again keeps the layer.
                    let layer = old
                        .filter(|(old, handles, _)| (*old, handles) == (picture, &p))
                        .and_then(|(_, _, layer)| layer);
                    (id, Some((picture, p, layer)), request, &[200, 201])
                }
            };
        let states = book.entry(id).or_insert_with(|| vec![None]);
        states.push(new.clone());
        states.dedup();
        match answered(request, expected).await {
            Ok(Some(_)) => *states = vec![new],
            Ok(None) => {}
            Err(_) => return book,
        }
    }
}

/// Looks at every session; what is found is what is known from then on. How many there are.
async fn look(base: &str, pictures: &[Picture], book: &mut Book) -> usize {
    let http = Client::builder()
        .timeout(Duration::from_secs(60))
        .build()
        .unwrap();
    let mut there = 0;
    for (id, states) in book.iter_mut() {
        let url = format!("{base}/sessions/{id}");
        let answer = http.get(&url).send().await.unwrap();
        let found = match answer.status().as_u16() {
            404 => None,
            200 => {
                let session: Value = answer.json().await.unwrap();
                let picture = (0..pictures.len())
                    .find(|&k| pictures[k].pixels.width as u64 == session["image"]["width"])
                    .unwrap();
                let layer = if session["layers"].is_object() {
                    let file = http
                        .get(format!("{url}/layers/x"))
                        .send()
                        .await
                        .unwrap()
                        .bytes()
                        .await
                        .unwrap();
                    let layer = (0..3).find(|&k| pictures[picture].layers[k] == file);
                    assert!(layer.is_some(), "{id}: another file");
                    layer
                } else {
                    None
                };
                Some((picture, session["p"].clone(), layer))
            }
            status => panic!("{status} for {id}"),
        };
        assert!(
            states.contains(&found),
            "lost: {id} is {found:?}, and was answered as {states:?}"
        );
        if let Some((picture, p, _)) = &found {
            there += 1;
            let bent = http
                .post(format!("{url}/warp"))
                .json(&json!({"q": p}))
                .send()
                .await
                .unwrap();
            assert_eq!(bent.status(), 200, "{id}");
            assert!(
                decoded(&bent.bytes().await.unwrap()) == pictures[*picture].pixels,
                "{id}: another picture"
            );
        }
        *states = vec![found];
    }
    book.retain(|_, states| states[0].is_some());
    there
}

struct Loop {
    pictures: Arc<Vec<Picture>>,
    books: Vec<Book>,
    asked: Arc<AtomicU64>,
    dice: Dice,
    checked: usize,
    slowest: Duration,
}

impl Loop {
    fn new(seed: u64) -> Self {
        let books = (0..CLIENTS).map(|_| Book::new()).collect();
        Self {
            pictures: pictures(),
            books,
            asked: Arc::default(),
            dice: Dice(seed),
            checked: 0,
            slowest: Duration::ZERO,
        }
    }

    fn start(&mut self, store: &str) -> Program {
        let began = Instant::now();
        let program = Program::start(&["--store", store, "--workers", "2"]);
        self.slowest = self.slowest.max(began.elapsed());
        program
    }

    /// Clients work for a while; then `end` is called, and they stop when their server is gone.
    async fn work(&mut self, program: Program, end: impl AsyncFnOnce(Program)) {
        let base = format!("http://{}", program.address);
        let clients: Vec<_> = std::mem::take(&mut self.books)
            .into_iter()
            .map(|book| {
                let dice = Dice(self.dice.below(usize::MAX) as u64);
                tokio::spawn(client(
                    base.clone(),
                    Arc::clone(&self.pictures),
                    book,
                    dice,
                    Arc::clone(&self.asked),
                ))
            })
            .collect();
        tokio::time::sleep(Duration::from_millis(100 + self.dice.below(400) as u64)).await;
        end(program).await;
        for client in clients {
            self.books.push(client.await.unwrap());
        }
    }

    async fn look(&mut self, program: &Program) {
        let base = format!("http://{}", program.address);
        for book in &mut self.books {
            self.checked += look(&base, &self.pictures, book).await;
        }
    }

    fn tell(&self, what: &str, rounds: usize) {
        let (asked, checked) = (self.asked.load(Ordering::Relaxed), self.checked);
        eprintln!(
            "{what}: {rounds} kills, {asked} requests, {checked} sessions looked at after them, \
                none lost; slowest start {:?}",
            self.slowest
        );
        assert!(checked > 2 * rounds, "the clients did something");
    }
}

fn rounds(brief: usize) -> usize {
    if is_full() { 10 * brief } else { brief }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_kill_loses_nothing_that_was_answered_file() {
    let scratch = Scratch::new();
    let store = format!("file:{}", scratch.path("sessions.db"));
    let mut all = Loop::new(1);
    let mut program = all.start(&store);
    for _ in 0..rounds(20) {
        all.work(program, async |program| drop(program)).await;
        program = all.start(&store);
        all.look(&program).await;
    }
    all.tell("file store, SIGKILL", rounds(20));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_kill_loses_nothing_that_was_answered_redis() {
    let redis = Redis::start(&[]);
    let mut all = Loop::new(2);
    let mut program = all.start(&redis.address());
    for _ in 0..rounds(20) {
        all.work(program, async |program| drop(program)).await;
        program = all.start(&redis.address());
        all.look(&program).await;
    }
    all.tell("Redis, SIGKILL of mlswarp", rounds(20));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_kill_loses_nothing_that_was_answered_of_redis_itself() {
    let mut redis = Redis::start(&["--appendonly", "yes", "--appendfsync", "always"]);
    let mut all = Loop::new(3);
    for _ in 0..rounds(4) {
        let program = all.start(&redis.address());
        all.work(program, async |program| {
            redis.kill();
            // They are refused for a while, and then have to do with the server that is back.
            tokio::time::sleep(Duration::from_millis(300)).await;
            redis.start_again();
            tokio::time::sleep(Duration::from_millis(1500)).await;
            drop(program);
        })
        .await;
        let program = all.start(&redis.address());
        all.look(&program).await;
    }
    all.tell("Redis, SIGKILL of redis-server", rounds(4));
}
