//! Two processes that are timed in turn. The one that is asked says `ready`, reads names of
//! contenders, one a line, and answers each with the seconds of a call; the process that asks runs
//! its own contenders in between, so that medians of both come from the same minutes.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use super::Contender;

/// Answers until the input ends.
pub fn serve(contenders: &mut [Contender<'_>]) {
    let mut repeats: Vec<Option<u32>> = vec![None; contenders.len()];
    say("ready");
    for name in std::io::stdin().lines().map_while(Result::ok) {
        let index = contenders
            .iter()
            .position(|c| c.name == name)
            .unwrap_or_else(|| panic!("{name} is not timed here"));
        let repeats = *repeats[index].get_or_insert_with(|| contenders[index].repeats());
        say(&format!("{:e}", contenders[index].sample(repeats)));
    }
}

fn say(line: &str) {
    println!("{line}");
    std::io::stdout()
        .flush()
        .expect("the other process listens");
}

/// This program once more, in a process that is asked; it ends with this value.
pub struct Other {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Other {
    pub fn start(arguments: &[&str], variables: &[(&str, &str)]) -> Self {
        let program = std::env::current_exe().expect("a program knows where it lies");
        let mut command = Command::new(program);
        command
            .args(arguments)
            .envs(variables.iter().copied())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        let mut child = command.spawn().expect("a second process starts");
        let (input, output) = (
            child.stdin.take().expect("piped"),
            BufReader::new(child.stdout.take().expect("piped")),
        );
        let mut other = Self {
            child,
            input,
            output,
        };
        assert_eq!(other.hear(), "ready");
        other
    }

    /// The seconds that one call of a contender takes in the other process.
    pub fn seconds(&mut self, name: &str) -> f64 {
        writeln!(self.input, "{name}").expect("the other process reads");
        self.hear().parse().expect("seconds")
    }

    fn hear(&mut self) -> String {
        let mut line = String::new();
        self.output
            .read_line(&mut line)
            .expect("the other process answers");
        line.trim_end().to_owned()
    }
}

impl Drop for Other {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Writes the files that a rival in another language works on.
pub fn write(folder: &Path, name: &str, bytes: &[u8]) {
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(folder.join(name), bytes))
        .expect("the folder takes files");
}
