//! The relay of `relay.rs` as a program, for tests in other languages:
//!
//! ```text
//! link 127.0.0.1:8080 MBIT MS     prints its own port; Mbit/s and the delay in ms, the same in
//! both
//!                                 directions
//! ```
//!
//! It reads commands from its standard input, answers each with `ok`, and ends with the input:
//! `rate MBIT` changes the rate, `pause SECONDS` passes nothing for this time, `cut` ends the
//! connections.

#![expect(
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a program that prints its port and takes numbers from its caller"
)]

mod relay;

use std::error::Error;
use std::io::Write as _;
use std::time::Duration;

use relay::{Link, Relay};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [server, megabits, milliseconds] = &*arguments else {
        return Err("usage: link ADDRESS MBIT MS".into());
    };
    let link = Link {
        rate: rate(megabits)?,
        delay: Duration::try_from_secs_f64(milliseconds.parse::<f64>()? / 1e3)?,
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    let relay = runtime.block_on(async {
        Relay::start(server.parse()?, link, link).map_err(Box::<dyn Error>::from)
    })?;
    say(&relay.address.port().to_string())?;
    for line in std::io::stdin().lines() {
        match line?.split_whitespace().collect::<Vec<_>>()[..] {
            ["rate", megabits] => {
                relay.up.set_rate(rate(megabits)?);
                relay.down.set_rate(rate(megabits)?);
            }
            ["pause", seconds] => relay.pause(Duration::try_from_secs_f64(seconds.parse()?)?),
            ["cut"] => relay.cut(),
            ref other => return Err(format!("unknown command: {}", other.join(" ")).into()),
        }
        say("ok")?;
    }
    Ok(())
}

/// Bytes per second.
fn rate(megabits: &str) -> Result<u64, Box<dyn Error>> {
    let rate = megabits.parse::<f64>()? * 125_000.0;
    if (1.0..1e12).contains(&rate) {
        Ok(rate as u64)
    } else {
        Err(format!("not a rate: {megabits}").into())
    }
}

fn say(line: &str) -> std::io::Result<()> {
    println!("{line}");
    std::io::stdout().flush()
}
