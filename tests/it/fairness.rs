//! What one client can take from the others: the table in `deploy/README.md`, a test for each of
//! its rows. Clients without keys are told apart by their addresses; on Linux all of 127.0.0.0/8 is
//! the loopback. The tests count answers and their order; times are printed.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use mlswarp_server::client::{Client as Who, Owner};
use mlswarp_server::limits::memory::MemoryClass;
use mlswarp_server::pool::{QueueKey, WorkClass};
use reqwest::{Client, RequestBuilder, Response};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinHandle;

use crate::support::counters::Counted as _;
use crate::support::server::{form, header, png, problem};
use crate::support::{DragClient, Server, eventually, photo};

/// A client at an address of its own.
#[derive(Clone)]
struct Party {
    http: Client,
    address: IpAddr,
    server: SocketAddr,
}

impl Party {
    fn new(server: &Server, last: u8) -> Self {
        let address = IpAddr::V4(Ipv4Addr::new(127, 0, 0, last));
        Self {
            http: Client::builder().local_address(address).build().unwrap(),
            address,
            server: server.address,
        }
    }

    fn who(&self) -> Who {
        Who {
            owner: Owner::ANYBODY,
            address: self.address,
            visit: None,
        }
    }

    fn post(&self, path: &str) -> RequestBuilder {
        self.http.post(format!("http://{}{path}", self.server))
    }

    async fn open(&self, image: &[u8], warp: &Value) -> Response {
        self.post("/sessions")
            .multipart(form(image, warp.to_string()))
            .send()
            .await
            .unwrap()
    }

    async fn session(&self, image: &[u8]) -> String {
        let answer = self.open(image, &rest()).await;
        assert_eq!(answer.status(), 201, "{:?}", answer.text().await);
        id_of(answer).await
    }

    async fn delete(&self, id: &str) -> u16 {
        self.http
            .delete(format!("http://{}/sessions/{id}", self.server))
            .send()
            .await
            .unwrap()
            .status()
            .as_u16()
    }

    /// A handshake of the drag socket; the seat is taken for as long as the answer lives.
    async fn socket(&self, id: &str) -> Response {
        let request = self
            .http
            .get(format!("http://{}/sessions/{id}/drag", self.server));
        let request = request
            .header("Connection", "upgrade")
            .header("Upgrade", "websocket")
            .header("Sec-WebSocket-Version", "13");
        request
            .header("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ==")
            .send()
            .await
            .unwrap()
    }

    async fn connect(&self) -> TcpStream {
        let socket = TcpSocket::new_v4().unwrap();
        socket.bind(SocketAddr::new(self.address, 0)).unwrap();
        socket.connect(self.server).await.unwrap()
    }
}

async fn id_of(answer: Response) -> String {
    answer.json::<Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned()
}

fn rest() -> Value {
    json!({"p": [[20, 20]]})
}

/// 429, with the limit and a time to come back.
async fn limited(answer: Response, what: &str) {
    assert!(header(&answer, "retry-after").parse::<u32>().unwrap() >= 1);
    let told = problem(answer, 429, "rate_limited").await;
    assert_eq!(told["limit_name"], what, "{told}");
    assert!(
        told["actual"].as_u64().unwrap() > told["limit"].as_u64().unwrap(),
        "{told}"
    );
}

/// Requests that are sent again and again until this is dropped, and how many were answered with a
/// picture.
struct Flood {
    answered: Arc<AtomicUsize>,
    over: Arc<AtomicBool>,
    tasks: Vec<JoinHandle<()>>,
}

impl Flood {
    /// `at_once` requests at a time; `ask` makes the n-th request of a task.
    fn start(
        at_once: usize,
        ask: impl Fn(usize, u64) -> RequestBuilder + Clone + Send + 'static,
    ) -> Self {
        let (answered, over) = (
            Arc::new(AtomicUsize::new(0)),
            Arc::new(AtomicBool::new(false)),
        );
        let task = |task: usize| {
            let (ask, answered, over) = (ask.clone(), Arc::clone(&answered), Arc::clone(&over));
            tokio::spawn(async move {
                for n in 0.. {
                    if over.load(Ordering::Relaxed) {
                        return;
                    }
                    let Ok(answer) = ask(task, n).send().await else {
                        continue;
                    };
                    let is_picture = answer.status() == 200;
                    let whole = answer.bytes().await.is_ok();
                    answered.fetch_add(usize::from(is_picture && whole), Ordering::Relaxed);
                }
            })
        };
        let tasks = (0..at_once).map(task).collect();
        Self {
            answered,
            over,
            tasks,
        }
    }

    fn answered(&self) -> usize {
        self.answered.load(Ordering::Relaxed)
    }

    async fn end(self) {
        self.over.store(true, Ordering::Relaxed);
        for task in self.tasks {
            task.await.unwrap();
        }
    }
}

/// Asks one after the other; prints what a client that asks for little has to wait. How many others
/// were answered meanwhile.
async fn meanwhile(what: &str, number: usize, flood: &Flood, ask: impl AsyncFn(usize)) -> usize {
    let (before, mut times) = (flood.answered(), Vec::new());
    for n in 0..number {
        let began = Instant::now();
        ask(n).await;
        times.push(began.elapsed());
    }
    let others = flood.answered() - before;
    times.sort_unstable();
    let p99 = times[(number * 99).div_ceil(100) - 1];
    eprintln!(
        "{what}: {number} of {} answers; median {:.0?}, p99 {p99:.0?}",
        number + others,
        times[number / 2]
    );
    others
}

async fn drag(party: &Party, id: &str, n: usize) {
    let answer = party
        .post(&format!("/sessions/{id}/warp"))
        .json(&json!({"q": [[20 + n % 9, 21]]}))
        .send()
        .await
        .unwrap();
    assert_eq!(answer.status(), 200);
    // Not decoded: the client is back at once.
    assert!(answer.bytes().await.unwrap().starts_with(b"\x89PNG"));
}

/// Row: turns at the workers. Six busy sessions at one address against one session at another.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn six_busy_sessions_do_not_starve_the_session_of_another_address() {
    for workers in ["1", "2"] {
        let server = Server::start(&["--workers", workers]).await;
        let (busy, calm) = (Party::new(&server, 2), Party::new(&server, 3));
        let mut ids = Vec::new();
        for _ in 0..6 {
            ids.push(busy.session(&photo(900, 700)).await);
        }
        let own = calm.session(&photo(900, 701)).await;
        let flood = Flood::start(12, {
            let busy = busy.clone();
            move |task, n| {
                busy.post(&format!("/sessions/{}/warp", ids[task % 6]))
                    .json(&json!({"q": [[20 + n % 9, 22]]}))
            }
        });
        eventually("the workers are busy", || flood.answered() > 12).await;
        let others = meanwhile(
            &format!("drags, {workers} workers"),
            40,
            &flood,
            async |n| drag(&calm, &own, n).await,
        )
        .await;
        flood.end().await;
        // As before there was a queue for each session: five and more for one.
        assert!(others <= 3 * 40, "{others} of the busy client beside 40");
    }
}

/// Row: worker time. A few huge requests of one client against many small ones of another, at both
/// gates.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn huge_requests_do_not_hold_all_workers_against_small_ones() {
    for workers in ["1", "2"] {
        let server = Server::start(&["--workers", workers]).await;
        let (huge, small) = (Party::new(&server, 2), Party::new(&server, 3));
        let large = huge.session(&photo(2000, 1500)).await;
        let own = small.session(&photo(64, 48)).await;
        let flood = Flood::start(4, {
            let huge = huge.clone();
            let output = json!({"compression": "best"});
            move |_, n| {
                huge.post(&format!("/sessions/{large}/warp"))
                    .json(&json!({"q": [[20 + n % 9, 22]], "output": output}))
            }
        });
        eventually("a huge one runs", || {
            server.app.pool().load(WorkClass::Drag).waiting > 1
        })
        .await;
        let others = meanwhile(
            &format!("small drags, {workers} workers"),
            40,
            &flood,
            async |n| drag(&small, &own, n).await,
        )
        .await;
        flood.end().await;
        // Where each waits for the end of a huge one, there are as many of them.
        assert!(others <= 20, "{others} huge drags beside 40 small ones");

        let file = Arc::new(photo(1500, 1000));
        let warp = json!({"p": [[20, 20]], "q": [[25, 20]]});
        let flood = Flood::start(4, {
            let (file, mut warp) = (Arc::clone(&file), warp.clone());
            warp["output"] = json!({"compression": "best"});
            move |_, _| huge.post("/warp").multipart(form(&file, warp.to_string()))
        });
        eventually("a huge one runs", || {
            server.app.pool().load(WorkClass::Upload).waiting > 1
        })
        .await;
        let tiny = photo(32, 24);
        let upload = async |_| {
            png(small
                .post("/warp")
                .multipart(form(&tiny, warp.to_string()))
                .send()
                .await
                .unwrap())
            .await;
        };
        let others = meanwhile(
            &format!("small uploads, {workers} workers"),
            40,
            &flood,
            upload,
        )
        .await;
        flood.end().await;
        assert!(others <= 20, "{others} huge uploads beside 40 small ones");
    }
}

/// Row: worker time. Requests of a few kB that take many seconds each, from more addresses than
/// there are slots: they give way.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn long_requests_from_three_addresses_delay_a_short_one_no_more_than_from_one() {
    let p: Vec<[u32; 2]> = (0..700).map(|k| [k * 37 % 601, k * 59 % 397]).collect();
    let fit = json!({"p": p, "q": p, "extent": [640, 400],
        "candidates": vec![json!({"method": "tps"}); 40]});
    for addresses in [1, 3] {
        let server = Server::start(&["--workers", "2"]).await;
        let busy: Vec<Party> = (2..2 + addresses)
            .map(|last| Party::new(&server, last))
            .collect();
        let calm = Party::new(&server, 9);
        let floods: Vec<Flood> = busy
            .into_iter()
            .map(|party| {
                let fit = fit.clone();
                Flood::start(3, move |_, _| party.post("/fit").json(&fit))
            })
            .collect();
        eventually("they wait for slots", || {
            server.app.pool().load(WorkClass::Upload).waiting > 0
        })
        .await;
        let (tiny, warp) = (photo(32, 24), json!({"p": [[20, 20]], "q": [[25, 20]]}));
        let mut times = Vec::new();
        for _ in 0..10 {
            let began = Instant::now();
            png(calm
                .post("/warp")
                .multipart(form(&tiny, warp.to_string()))
                .send()
                .await
                .unwrap())
            .await;
            times.push(began.elapsed());
        }
        times.sort_unstable();
        eprintln!(
            "10 uploads beside long requests from {addresses} addresses: median {:.0?}, longest \
                {:.0?}",
            times[5], times[9]
        );
        floods
            .iter()
            .for_each(|flood| flood.tasks.iter().for_each(JoinHandle::abort));
    }
}

/// Row: turns, of drag sockets. Their frames wait behind those of the same client alone.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn many_sockets_do_not_starve_the_socket_of_another_address() {
    let server = Server::start(&["--workers", "1", "--queue", "8"]).await;
    let (busy, calm) = (Party::new(&server, 2), Party::new(&server, 3));
    let flood = Flood {
        answered: Arc::default(),
        over: Arc::default(),
        tasks: Vec::new(),
    };
    let mut tasks = Vec::new();
    for n in 0..16 {
        let id = busy.session(&photo(700 + n, 500)).await;
        let mut drag = DragClient::over(busy.connect().await, &id, "?width=700").await;
        let (answered, over) = (Arc::clone(&flood.answered), Arc::clone(&flood.over));
        tasks.push(tokio::spawn(async move {
            for seq in 0.. {
                if over.load(Ordering::Relaxed) {
                    return;
                }
                drag.pose(seq, &json!([[20 + seq % 9, 22]])).await;
                drag.ack_of_next_frame(seq).await;
                answered.fetch_add(1, Ordering::Relaxed);
            }
        }));
    }
    let flood = Flood { tasks, ..flood };
    let id = calm.session(&photo(700, 501)).await;
    let drag =
        tokio::sync::Mutex::new(DragClient::over(calm.connect().await, &id, "?width=700").await);
    eventually("the workers are busy", || flood.answered() > 16).await;
    let others = meanwhile("frames of a socket", 40, &flood, async |n| {
        let mut drag = drag.lock().await;
        drag.pose(n as u64, &json!([[20 + n % 9, 22]])).await;
        drag.ack_of_next_frame(n as u64).await;
    });
    let others = others.await;
    flood.end().await;
    assert!(
        others <= 4 * 40,
        "{others} frames of sixteen sockets beside 40 of one"
    );
}

/// Row: places in the queue. The client that has most of them makes room.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_full_queue_makes_room_at_the_cost_of_the_client_that_has_most() {
    let server = Server::start(&["--workers", "1", "--queue", "4"]).await;
    let (busy, calm, third) = (
        Party::new(&server, 2),
        Party::new(&server, 3),
        Party::new(&server, 4),
    );
    let own = calm.session(&photo(64, 48)).await;
    let mut ids = Vec::new();
    for _ in 0..6 {
        ids.push(busy.session(&photo(64, 48)).await);
    }
    eventually("nothing runs", || server.app.pool().running() == 0).await;
    // The turn and the spare one.
    let turn = |party: &Party| {
        server
            .app
            .pool()
            .admit(WorkClass::Drag, QueueKey::client(party.who()))
    };
    let held = (turn(&busy).await.unwrap(), turn(&third).await.unwrap());
    let ask = |party: &Party, id: &str| {
        tokio::spawn(
            party
                .post(&format!("/sessions/{id}/warp"))
                .json(&json!({"q": [[21, 20]]}))
                .send(),
        )
    };
    let many: Vec<_> = ids.iter().map(|id| ask(&busy, id)).collect();
    eventually("two found no place", || {
        server.app.pool().load(WorkClass::Drag).full == 2
    })
    .await;
    assert_eq!(
        server.get("/readyz").send().await.unwrap().status(),
        200,
        "others are served"
    );
    let one = ask(&calm, &own);
    eventually("it has a place", || {
        server.app.pool().load(WorkClass::Drag).full == 3
    })
    .await;
    drop(held);
    png(one.await.unwrap().unwrap()).await;
    let mut statuses = Vec::new();
    for request in many {
        statuses.push(request.await.unwrap().unwrap().status().as_u16());
    }
    statuses.sort_unstable();
    assert_eq!(statuses, [200, 200, 200, 503, 503, 503]);
}

/// Rows: sessions, and what a trusted proxy says.
#[tokio::test]
async fn one_client_has_half_of_the_sessions() {
    let server = Server::start(&["--max-sessions", "4"]).await;
    let (one, other) = (Party::new(&server, 2), Party::new(&server, 3));
    let file = photo(64, 48);
    let ids = [one.session(&file).await, one.session(&file).await];
    limited(one.open(&file, &rest()).await, "client_sessions").await;
    let warped = one.post("/warp?session=true").multipart(form(
        &file,
        json!({"p": [[20, 20]], "q": [[21, 20]]}).to_string(),
    ));
    limited(warped.send().await.unwrap(), "client_sessions").await;
    // Replacing one of its own is no more than it had.
    let again = one
        .http
        .put(format!("http://{}/sessions/{}", server.address, ids[0]))
        .multipart(form(&photo(65, 48), rest().to_string()));
    assert_eq!(again.send().await.unwrap().status(), 200);
    let theirs = [other.session(&file).await, other.session(&file).await];
    // The store's own limit stays what it was.
    problem(
        Party::new(&server, 4).open(&file, &rest()).await,
        503,
        "overloaded",
    )
    .await;
    assert_eq!(one.delete(&ids[1]).await, 204);
    one.session(&file).await;
    limited(one.open(&file, &rest()).await, "client_sessions").await;
    drag(&other, &theirs[0], 1).await;

    let behind = Server::start(&["--max-sessions", "4", "--trusted-proxies", "127.0.0.0/8"]).await;
    let open = |from: &'static str| {
        behind
            .post("/sessions")
            .header("X-Forwarded-For", from)
            .multipart(form(&file, rest().to_string()))
            .send()
    };
    for _ in 0..2 {
        assert_eq!(open("2001:db8::1").await.unwrap().status(), 201);
    }
    limited(open("2001:db8::2").await.unwrap(), "client_sessions").await;
    assert_eq!(open("2001:db8:0:1::1").await.unwrap().status(), 201);

    let off = Server::start(&["--max-sessions", "4", "--max-client-share", "100"]).await;
    for _ in 0..4 {
        off.session(&file, &rest()).await;
    }
    problem(
        off.upload("/sessions", &file, &rest()).await,
        503,
        "overloaded",
    )
    .await;
}

/// Row: sessions, where there are keys: the name counts, from whatever address.
#[tokio::test]
async fn one_key_has_half_of_the_sessions_from_all_its_addresses() {
    let server = Server::start(&[
        "--max-sessions",
        "4",
        "--keys",
        "ann ann-s-key-0123456789,bob bob-s-key-9876543210",
    ])
    .await;
    let open = async |last: u8, key: &str| {
        let request = Party::new(&server, last)
            .post("/sessions")
            .bearer_auth(key)
            .multipart(form(&photo(64, 48), rest().to_string()));
        request.send().await.unwrap()
    };
    for last in [2, 3] {
        assert_eq!(open(last, "ann-s-key-0123456789").await.status(), 201);
    }
    limited(open(4, "ann-s-key-0123456789").await, "client_sessions").await;
    assert_eq!(open(2, "bob-s-key-9876543210").await.status(), 201);
}

/// Row: sessions that have expired count no more.
#[tokio::test]
async fn expired_sessions_make_room_for_their_client() {
    let server = Server::start(&["--max-sessions", "4", "--session-idle", "4s"]).await;
    let one = Party::new(&server, 2);
    let file = photo(64, 48);
    one.session(&file).await;
    one.session(&file).await;
    limited(one.open(&file, &rest()).await, "client_sessions").await;
    let began = Instant::now();
    while one.open(&file, &rest()).await.status() != 201 {
        assert!(began.elapsed() < Duration::from_secs(30), "they expire");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// Row: bytes in the store.
#[tokio::test]
async fn one_client_has_half_of_the_stored_bytes() {
    let files: Vec<Vec<u8>> = (0..4).map(|n| photo(300 + n, 200)).collect();
    let size = files[0].len() + 4096;
    let server = Server::start(&["--store-bytes", &(4 * size).to_string()]).await;
    let (one, other) = (Party::new(&server, 2), Party::new(&server, 3));
    // The same file is kept once.
    for file in [&files[0], &files[1], &files[1]] {
        one.session(file).await;
    }
    limited(one.open(&files[2], &rest()).await, "client_store_bytes").await;
    // Handles are a part of it.
    let id = other.session(&files[2]).await;
    let p: Vec<[u32; 2]> = (0..9000).map(|n| [n % 300, n / 300]).collect();
    let handles = other
        .http
        .put(format!("http://{}/sessions/{id}/handles", server.address))
        .json(&json!({"p": p, "grid": {"columns": 2, "rows": 2}}));
    limited(handles.send().await.unwrap(), "client_store_bytes").await;
    other.session(&files[3]).await;
}

/// Row: drag sockets.
#[tokio::test]
async fn one_client_has_half_of_the_sockets() {
    let server = Server::start(&["--max-sockets", "4"]).await;
    let (one, other) = (Party::new(&server, 2), Party::new(&server, 3));
    let id = one.session(&photo(64, 48)).await;
    let mut open = vec![one.socket(&id).await, one.socket(&id).await];
    limited(one.socket(&id).await, "client_sockets").await;
    open.extend([other.socket(&id).await, other.socket(&id).await]);
    assert!(open.iter().all(|answer| answer.status() == 101));
    problem(Party::new(&server, 4).socket(&id).await, 503, "overloaded").await;
    drop(open);
    eventually("the seats are free again", || {
        server.app.counters().sockets_open == 0
    })
    .await;
    assert_eq!(one.socket(&id).await.status(), 101);
}

/// Row: memory of requests that are being sent. Uploads, and bodies of drags.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_client_has_half_of_the_memory_for_uploads() {
    const SENT: u64 = 2_000_000;
    /// Reserved for an upload beside its bytes: the request and the parser of its parts.
    const BESIDE_BYTES: u64 = (16 << 10) + (128 << 10);
    let server = Server::start(&[
        "--memory-bytes=32MiB",
        "--body-timeout=5min",
        "--request-timeout=5min",
    ])
    .await;
    let (one, other) = (Party::new(&server, 2), Party::new(&server, 3));
    let id = other.session(&photo(64, 48)).await;
    let limit = server.app.admission.request_quota(one.who()).limit();
    assert_eq!(limit, 12 << 20);
    // Uploads of which all but a hundred bytes come.
    let part = "--x\r\nContent-Disposition: form-data; name=\"image\"; filename=\"a\"\r\n\r\n";
    let announced = part.len() as u64 + SENT + 100;
    let head = format!(
        "POST /warp HTTP/1.1\r\nHost: {}\r\nContent-Type: multipart/form-data; \
            boundary=x\r\nContent-Length: {announced}\r\n\r\n{part}",
        server.address
    );
    let sent = [head.as_bytes(), &vec![0; SENT as usize]].concat();
    // How many uploads have come, unless one of them grows or goes: then more is held for a moment
    // than what has come.
    let arrived = || {
        let held = server.app.admission.request_quota(one.who()).held();
        assert!(held <= limit);
        let count = held / (SENT + BESIDE_BYTES);
        (held % (SENT + BESIDE_BYTES) <= (announced - SENT) * count).then_some(count)
    };
    let (mut streams, mut refused) = (Vec::new(), 0);
    for _ in 0..12 {
        eventually("nothing changes", || arrived().is_some()).await;
        let before = arrived();
        let mut stream = one.connect().await;
        // Refused while it sends: what it writes then may find nobody.
        let _ = stream.write_all(&sent).await;
        let mut status = [0; 12];
        tokio::select! {
            read = stream.read_exact(&mut status) => {
                read.unwrap();
                assert_eq!(&status, b"HTTP/1.1 429");
                refused += 1;
            }
            () = eventually("its bytes have come", || arrived() > before) => {}
        }
        streams.push(stream);
    }
    let taken = server.app.budget().taken_for(MemoryClass::Upload);
    eprintln!(
        "{} uploads are held, {refused} were refused; {taken} bytes are taken, \
         {limit} is the limit",
        streams.len() - refused
    );
    assert!(refused >= 6 && streams.len() - refused >= 2);
    // Uploads and drags of others have their own part.
    for n in 0..5 {
        png(other
            .post("/warp")
            .multipart(form(
                &photo(200, 150),
                json!({"p": [[2, 2]], "q": [[3, 2]]}).to_string(),
            ))
            .send()
            .await
            .unwrap())
        .await;
        drag(&other, &id, n).await;
    }
    drop(streams);
    eventually("it is given back", || {
        server.app.admission.request_quota(one.who()).held() == 0
    })
    .await;
}
