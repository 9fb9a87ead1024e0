//! The program itself, as a user starts it.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::SocketAddr;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

/// `mlswarp`, with nothing of ours in its environment.
pub(crate) fn mlswarp(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mlswarp"));
    command.args(args);
    // A backtrace of a program with debug information takes 280 MiB to print.
    command.env("RUST_BACKTRACE", "0");
    for (name, _) in
        std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("MLSWARP_"))
    {
        command.env_remove(name);
    }
    command
}

/// Runs the program with text on its standard input.
pub(crate) fn run(args: &[&str], stdin: &str) -> Output {
    let mut child = mlswarp(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A command that fails at once closes the pipe.
    let _ = child.stdin.take().unwrap().write_all(stdin.as_bytes());
    child.wait_with_output().unwrap()
}

/// Standard output of a command that succeeds, and what it says.
pub(crate) fn done(args: &[&str], stdin: &str) -> (Vec<u8>, String) {
    let output = run(args, stdin);
    assert!(output.status.success(), "{args:?}: {output:?}");
    (output.stdout, String::from_utf8(output.stderr).unwrap())
}

/// What a command says that fails.
pub(crate) fn failed(args: &[&str], stdin: &str) -> String {
    let output = run(args, stdin);
    assert!(
        output.status.code() == Some(1) && output.stdout.is_empty(),
        "{args:?}: {output:?}"
    );
    String::from_utf8(output.stderr).unwrap()
}

/// A server in a process of its own; killed when dropped.
pub(crate) struct Program {
    pub(crate) address: SocketAddr,
    child: Child,
    log: Option<std::thread::JoinHandle<String>>,
}

impl Program {
    pub(crate) fn start(args: &[&str]) -> Self {
        Self::spawn(mlswarp(
            &[&["serve", "--listen", "127.0.0.1:0"], args].concat(),
        ))
    }

    /// A command that comes to be the server.
    pub(crate) fn spawn(mut command: Command) -> Self {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        let address = loop {
            let before = said.len();
            assert_ne!(
                lines.read_line(&mut said).unwrap(),
                0,
                "the server ended before it listened"
            );
            let line = &said[before..];
            if let Some((_, address)) = line.split_once("://") {
                let end = address
                    .find(|c: char| !"0123456789.:".contains(c))
                    .unwrap_or(address.len());
                break address[..end].parse().unwrap();
            }
        };
        let log = std::thread::spawn(move || {
            let _ = lines.read_to_string(&mut said);
            said
        });
        Self {
            address,
            child,
            log: Some(log),
        }
    }

    /// Its process.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Resident memory, MiB.
    pub(crate) fn resident(&self) -> u64 {
        self.memory("VmRSS:")
    }

    /// The most resident memory since it was forgotten, MiB.
    pub(crate) fn peak(&self) -> u64 {
        self.memory("VmHWM:")
    }

    /// From now on, the peak is that of what follows.
    pub(crate) fn forget_peak(&self) {
        std::fs::write(format!("/proc/{}/clear_refs", self.id()), "5").unwrap();
    }

    fn memory(&self, name: &str) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.id())).unwrap();
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix(name))
            .unwrap();
        line.trim()
            .trim_end_matches(" kB")
            .trim()
            .parse::<u64>()
            .unwrap()
            >> 10
    }

    /// Time of the processors that it has used.
    pub(crate) fn busy(&self) -> Duration {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.id())).unwrap();
        // In user mode and in the kernel, in ticks of 10 ms, counted behind the name.
        let fields: Vec<&str> = stat.rsplit(") ").next().unwrap().split(' ').collect();
        Duration::from_millis(
            10 * fields[11..13]
                .iter()
                .map(|ticks| ticks.parse::<u64>().unwrap())
                .sum::<u64>(),
        )
    }

    /// SIGTERM.
    pub(crate) fn terminate(&self) {
        let sent = Command::new("kill")
            .args(["-TERM", &self.child.id().to_string()])
            .status()
            .unwrap();
        assert!(sent.success());
    }

    /// Waits for the end; says what was logged.
    pub(crate) fn wait(mut self) -> (ExitStatus, String) {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                let log = self.log.take().unwrap().join().unwrap();
                return (status, log);
            }
            assert!(
                began.elapsed() < Duration::from_secs(60),
                "the server does not end"
            );
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
