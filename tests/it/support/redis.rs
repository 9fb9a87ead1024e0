//! A Redis of the test's own: on a free port of the loopback, in a directory of its own, ended with
//! the test.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// `redis-server` in a process of its own.
pub(crate) struct Redis {
    child: Child,
    port: u16,
    directory: PathBuf,
    options: Vec<String>,
}

impl Redis {
    /// Starts one that keeps nothing; `options` are the server's own (`--maxmemory`, `4mb`).
    pub(crate) fn start(options: &[&str]) -> Self {
        let directory =
            std::env::temp_dir().join(format!("mlswarp-redis-{}", uuid::Uuid::new_v4()));
        std::fs::create_dir(&directory).unwrap();
        let options: Vec<String> = options.iter().map(|&option| option.to_owned()).collect();
        // Somebody else may take a free port before the server does.
        for _ in 0..10 {
            let port = TcpListener::bind("127.0.0.1:0")
                .unwrap()
                .local_addr()
                .unwrap()
                .port();
            let mut redis = Self {
                child: spawn(port, &directory, &options),
                port,
                directory: directory.clone(),
                options: options.clone(),
            };
            if redis.answers() {
                return redis;
            }
            let _ = redis.child.wait();
            std::mem::take(&mut redis.directory);
        }
        panic!("redis-server does not start");
    }

    /// The address for `--store`.
    pub(crate) fn address(&self) -> String {
        format!("redis://127.0.0.1:{}", self.port)
    }

    /// SIGKILL.
    pub(crate) fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// On the same port, after it was killed.
    pub(crate) fn start_again(&mut self) {
        let began = Instant::now();
        loop {
            self.child = spawn(self.port, &self.directory, &self.options);
            if self.answers() {
                return;
            }
            assert!(
                began.elapsed() < Duration::from_secs(20),
                "redis-server does not start again"
            );
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// SIGSTOP or SIGCONT: a server that takes connections and says nothing, and its end.
    pub(crate) fn signal(&self, name: &str) {
        assert!(
            Command::new("kill")
                .args([name, &self.child.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
    }

    /// What the server says to one command.
    pub(crate) fn say(&self, command: &str) -> String {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream
            .write_all(format!("{command}\r\nQUIT\r\n").as_bytes())
            .unwrap();
        let mut said = String::new();
        stream.read_to_string(&mut said).unwrap();
        said.strip_suffix("+OK\r\n").unwrap_or_default().to_owned()
    }

    /// Waits until it answers; `false` when it has ended.
    fn answers(&mut self) -> bool {
        let began = Instant::now();
        loop {
            let mut answer = [0; 7];
            let pong = TcpStream::connect(("127.0.0.1", self.port)).and_then(|mut stream| {
                stream.set_read_timeout(Some(Duration::from_secs(1)))?;
                stream.write_all(b"PING\r\n")?;
                stream.read_exact(&mut answer)
            });
            let ended = self.child.try_wait().unwrap().is_some();
            if ended || (pong.is_ok() && [b"+PONG\r\n", b"-NOAUTH"].contains(&&answer)) {
                return !ended;
            }
            assert!(
                began.elapsed() < Duration::from_secs(20),
                "redis-server does not answer"
            );
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

fn spawn(port: u16, directory: &PathBuf, options: &[String]) -> Child {
    Command::new("redis-server")
        .args([
            "--bind",
            "127.0.0.1",
            "--port",
            &port.to_string(),
            "--save",
            "",
            "--dir",
        ])
        .arg(directory)
        .args(options)
        .stdout(Stdio::null())
        .spawn()
        .expect("redis-server is there: tests/run installs it")
}

impl Drop for Redis {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if !self.directory.as_os_str().is_empty() {
            let _ = std::fs::remove_dir_all(&self.directory);
        }
    }
}
