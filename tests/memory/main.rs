//! The memory of drags, in a process of its own: what one request allocates, and that what stays
//! does not grow. One test, because the counters are the process's.

#![expect(
    clippy::unwrap_used,
    clippy::cast_possible_wrap,
    reason = "a failed unwrap is a failed test; sizes are small"
)]

#[expect(unsafe_code, reason = "an allocator is unsafe to write")]
mod allocator;
mod client;

use std::fmt::Write as _;
use std::net::SocketAddr;
use std::time::Duration;

use client::Client;
use mlswarp_server::app::App;
use mlswarp_server::config::Config;
use mlswarp_server::http::connection::{listen, serve};

/// What may stay more after many requests than after a few, bytes.
const GROWTH: i64 = 64 << 10;
/// Target pictures that one request may allocate.
const PICTURES: u64 = 2;

/// Where twelve handles rest, as parts of the sides; the first eleven are dragged.
const REST: [[f64; 2]; 12] = [
    [0.2, 0.2],
    [0.8, 0.25],
    [0.5, 0.5],
    [0.25, 0.75],
    [0.75, 0.8],
    [0.5, 0.1],
    [0.1, 0.5],
    [0.9, 0.55],
    [0.5, 0.9],
    [0.35, 0.4],
    [0.65, 0.6],
    [0.05, 0.05],
];

#[test]
fn memory_of_a_drag_is_bounded_and_of_many_flat() {
    allocator::leave_this_thread_out();
    let full = std::env::var_os("MLSWARP_TESTS_FULL").is_some();
    // On a busy machine four clients wait for two workers.
    let patient = ["mlswarp", "--listen", "127.0.0.1:0", "--drag-wait", "1m"];
    let config = Config::read(patient).unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .unwrap();
    let listener = listen(config.listen).unwrap();
    let address = listener.local_addr().unwrap();
    let app = App::new(config).unwrap();
    runtime.spawn(serve(app.clone(), listener, std::future::pending()));
    let photograph = image::load_from_memory(include_bytes!("../images/astronaut.png")).unwrap();
    for (width, height, few, many) in [
        (500, 500, 200, 2000),
        (1920, 1080, 20, if full { 2000 } else { 60 }),
    ] {
        let resized = photograph
            .resize_exact(width, height, image::imageops::FilterType::Triangle)
            .to_rgba8();
        let mut file = std::io::Cursor::new(Vec::new());
        resized
            .write_to(&mut file, image::ImageFormat::Png)
            .unwrap();
        let mut drags = Drags::open(address, file.get_ref(), (width, height));
        let picture = 4 * u64::from(width) * u64::from(height);
        // A thread keeps the buffers of its first picture: all threads draw before anything is
        // compared, the spare one too, which one client alone wakes only on a busy machine.
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    allocator::leave_this_thread_out();
                    Drags::open(address, file.get_ref(), (width, height)).run(few);
                });
            }
        });
        drags.run(few);
        let after_few = settled(&app);
        let (asked, calls) = allocator::asked();
        drags.run(many - few);
        let after_many = settled(&app);
        let requests = u64::from(many - few);
        let (asked, calls) = (
            (allocator::asked().0 - asked) / requests,
            (allocator::asked().1 - calls) / requests,
        );
        println!(
            "{width} x {height}: a drag allocates {asked} bytes ({:.2} target pictures) in \
                {calls} calls; \
             {after_few} bytes live after {few}, {:+} after {many}",
            asked as f64 / picture as f64,
            after_many - after_few
        );
        assert!(
            asked <= PICTURES * picture,
            "a drag of {width} x {height} allocates {asked} bytes"
        );
        assert!(
            after_many - after_few <= GROWTH,
            "{} bytes more live after {many} drags than after {few}",
            after_many - after_few
        );
    }
}

/// What lives when nothing is under way any more.
fn settled(app: &App) -> i64 {
    let mut last = allocator::live();
    for _ in 0..200 {
        std::thread::sleep(Duration::from_millis(50));
        let live = allocator::live();
        if live == last && app.pool().running() == 0 {
            return live;
        }
        last = live;
    }
    panic!("the heap of an idle service does not come to rest");
}

/// A session that is dragged.
struct Drags {
    address: SocketAddr,
    client: Client,
    path: String,
    body: String,
    size: (u32, u32),
    step: u32,
}

impl Drags {
    fn open(address: SocketAddr, file: &[u8], size: (u32, u32)) -> Self {
        let mut drags = Self {
            address,
            client: Client::connect(address),
            path: String::new(),
            body: String::new(),
            size,
            step: 0,
        };
        drags.write_handles(0.0);
        let mut body =
            b"--b\r\nContent-Disposition: form-data; name=\"warp\"\r\n\r\n{\"p\": ".to_vec();
        body.extend_from_slice(drags.body.as_bytes());
        body.extend_from_slice(
            b"}\r\n--b\r\nContent-Disposition: form-data; name=\"image\"; filename=\"i\"\r\n\r\n",
        );
        body.extend_from_slice(file);
        body.extend_from_slice(b"\r\n--b--\r\n");
        let answer = drags
            .client
            .post("/sessions", "multipart/form-data; boundary=b", &body);
        assert_eq!(
            answer.status,
            201,
            "{}",
            String::from_utf8_lossy(answer.body)
        );
        let session: serde_json::Value = serde_json::from_slice(answer.body).unwrap();
        drags.path = format!("/sessions/{}/warp", session["id"].as_str().unwrap());
        drags
    }

    fn run(&mut self, times: u32) {
        // The buffers of the upload go with its connection, and on a busy machine the service has
        // closed one that was idle since the last drags.
        self.client = Client::connect(self.address);
        for _ in 0..times {
            self.step += 1;
            self.write_handles(0.02 * f64::from(self.step).sin());
            self.body.insert_str(0, "{\"q\": ");
            self.body.push('}');
            let answer = self
                .client
                .post(&self.path, "application/json", self.body.as_bytes());
            assert_eq!(
                answer.status,
                200,
                "{}",
                String::from_utf8_lossy(answer.body)
            );
            assert!(
                answer.body.starts_with(b"\x89PNG") && answer.body.ends_with(b"IEND\xaeB`\x82")
            );
        }
    }

    /// The handles, moved by a part of the sides: all but the last, in turn to either side.
    fn write_handles(&mut self, by: f64) {
        let (width, height) = (f64::from(self.size.0), f64::from(self.size.1));
        self.body.clear();
        for (k, [x, y]) in REST.into_iter().enumerate() {
            let by = if k + 1 == REST.len() {
                0.0
            } else {
                by * if k % 2 == 0 { 1.0 } else { -1.0 }
            };
            let before = if k == 0 { '[' } else { ',' };
            write!(
                self.body,
                "{before}[{:.3}, {:.3}]",
                (x + by) * width,
                (y - by) * height
            )
            .unwrap();
        }
        self.body.push(']');
    }
}
