//! The command line as a whole: which options have an effect on which subcommand, what its help
//! shows, and what a mistyped option meant.

use std::ffi::OsString;

use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command, CommandFactory as _, Error};

use super::Cli;
use super::option::{report, variable};

/// The option that shows the limits of a subcommand.
const HELP_LIMITS: &str = "help-limits";
/// Examples before everything else.
const TEMPLATE: &str =
    "{about-with-newline}\n{before-help}{usage-heading} {usage}\n\n{all-args}{after-help}";

const ROOT: &str = r"Examples:
  mlswarp                                            # the server, at http://127.0.0.1:8080
  mlswarp serve --help                               # all options of the server
  mlswarp warp cat.png warp.json -o warped.png       # without a server
  mlswarp batch cat.png warp.json --steps 24 -o cat.gif";

const WARP: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  mlswarp warp cat.png warp.json -o warped.png
  mlswarp warp cat.png warp.json --strength 0.5 --method similarity --width 800 -o half.jpg
  mlswarp warp in/*.png warp.json -o out/            # a folder of images
  mlswarp warp face.jpg --landmarks face.pts --landmarks-q average.pts -o average.jpg
  mlswarp warp in/ --landmarks in/ --landmarks-q average.pts -o out/   # a.jpg by a.pts, ...
  mlswarp warp labels.png warp.json --kind labels -o warped-labels.png"#;

const POINTS: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  echo '{"boxes": [[150, 90, 330, 150]]}' | mlswarp points warp.json - --image cat.png
  echo '{"points": [[9, 9]], "inverse": true}' | mlswarp points warp.json - --extent 451,300
  mlswarp points warp.json cells.geojson --extent 451,300 -o warped.geojson"#;

const MAP: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  mlswarp map warp.json --image cat.png -o map.npy    # cv2.remap(cat, numpy.load("map.npy"), ...)
  mlswarp map warp.json --extent 451,300 --direction forward -o forward.tif"#;

const REPORT: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  mlswarp report warp.json --image cat.png
  mlswarp report --landmarks face.pts --landmarks-q average.pts --image face.jpg -o report.json"#;

const FIT: &str = r#"Examples:
  mlswarp fit --landmarks landmarks.csv --image moving.tif     # a table, the best method first
  mlswarp fit warp.json --extent 451,300 -o fit.json           # the JSON of POST /fit
  echo '{"candidates": [{"method": "tps", "smoothing": 0.1}, {"method": "affine"}]}' |
    mlswarp fit - --landmarks landmarks.csv --image moving.tif"#;

const BATCH: &str = r#"Examples:
  echo '{"p": [[168, 112], [316, 136]], "q": [[150, 104], [338, 126]]}' > warp.json
  mlswarp batch cat.png warp.json --steps 24 --easing ease-in-out --and-back -o cat.gif
  mlswarp batch a.png --landmarks a.pts --landmarks-q b.pts --steps 7 -o continuum/
  echo '{"jitter": {"seed": 7, "count": 100, "sigma": 3}, "points": [[240, 250]]}' > jitter.json
  mlswarp batch cat.png jitter.json --layer mask=cat-labels.png:labels -o cats.zip"#;

const BLEND: &str = r#"Examples:
  mlswarp blend average/*.png -o average.png          # landmarks beside: a.pts of a.png
  mlswarp blend average/*.png --method affine --alpha 2 -o average.png   # smooth for faces
  mlswarp blend in/*.jpg --landmarks specimens.tps -o mean.png   # items named by their images
  mlswarp blend a.png b.png --steps 7 -o continuum/   # or morph.gif
  mlswarp blend a.png b.png --shape 0.4 --colour 0 -o shape-only.png
  mlswarp blend face.png average.png --shape 1.5,-0.5 --colour 1,0 -o caricature.png
  echo '{"images": [{"image": 0}, {"image": 0, "mirror": true}]}' > symmetric.json
  mlswarp blend face.png symmetric.json -o symmetric.png"#;

const HEALTH_CHECK: &str = "Examples:
  mlswarp health                                  # the server at 127.0.0.1:8080
  mlswarp health --listen 127.0.0.1:9000 || systemctl restart mlswarp
  MLSWARP_TLS_CERT=cert.pem MLSWARP_TLS_KEY=key.pem mlswarp health --listen 127.0.0.1:8443";

const VALUES: &str = "Sizes: 32MiB, 512K, 1048576. Times: 500ms, 30s, 15m. Every option can also \
    be set by the variable that its help names.";

/// The options that limit the work of a subcommand. An empty help text stands for that of the
/// server.
const LIMITS: [(&str, &str); 8] = [
    (
        "workers",
        "Number of compute threads. auto = number of cores",
    ),
    (
        "max-body-bytes",
        "Maximum size of the image file, of a landmark file, and of the annotations",
    ),
    ("max-warp-json-bytes", "Maximum size of the warp object"),
    ("max-image-pixels", ""),
    ("max-image-side", ""),
    ("max-columns", ""),
    (
        "max-fit-handles",
        "Maximum number of handles on which the method auto compares methods; the time grows with \
            its cube",
    ),
    ("max-plan-bytes", ""),
];

const MEMORY: (&str, &str) = (
    "memory-bytes",
    "Maximum memory for plans and results. auto = 6 tenths of the memory of the machine or of the \
        control group",
);
/// [`LIMITS`] and [`MEMORY`]: the options of the subcommands that run the use cases of the server,
/// which reserve memory.
const SERVICE: [(&str, &str); 9] = {
    let mut options = [MEMORY; 9];
    let (limits, _) = options.split_at_mut(LIMITS.len());
    limits.copy_from_slice(&LIMITS);
    options
};
const HEALTH: [(&str, &str); 4] = [
    ("listen", "Address and port of the server"),
    (
        "metrics-listen",
        "Metrics address and port of the server; if this is set, it is the one that is asked",
    ),
    (
        "tls-cert",
        "Certificate of the server, PEM: the only one that is trusted",
    ),
    (
        "tls-key",
        "Private key of the certificate (not used, but required with --tls-cert)",
    ),
];

/// A subcommand other than `serve`.
struct Subcommand {
    name: &'static str,
    examples: &'static str,
    /// The options of the server that have an effect on it, with their help texts, as in
    /// [`LIMITS`].
    effective: &'static [(&'static str, &'static str)],
    /// Whether its help leaves them out: they are limits, which few people need.
    has_limits: bool,
}

const SUBCOMMANDS: [Subcommand; 8] = [
    Subcommand {
        name: "warp",
        examples: WARP,
        effective: &LIMITS,
        has_limits: true,
    },
    Subcommand {
        name: "points",
        examples: POINTS,
        effective: &SERVICE,
        has_limits: true,
    },
    Subcommand {
        name: "map",
        examples: MAP,
        effective: &SERVICE,
        has_limits: true,
    },
    Subcommand {
        name: "batch",
        examples: BATCH,
        effective: &SERVICE,
        has_limits: true,
    },
    Subcommand {
        name: "blend",
        examples: BLEND,
        effective: &SERVICE,
        has_limits: true,
    },
    Subcommand {
        name: "report",
        examples: REPORT,
        effective: &SERVICE,
        has_limits: true,
    },
    Subcommand {
        name: "fit",
        examples: FIT,
        effective: &SERVICE,
        has_limits: true,
    },
    Subcommand {
        name: "health",
        examples: HEALTH_CHECK,
        effective: &HEALTH,
        has_limits: false,
    },
];

impl Subcommand {
    /// The first one that the arguments name.
    fn of(args: &[OsString]) -> Option<&'static Self> {
        args.iter()
            .skip(1)
            .find_map(|arg| SUBCOMMANDS.iter().find(|subcommand| arg == subcommand.name))
    }

    /// The help text of an option of the server; `None` if the option has no effect.
    fn help_of(&self, option: &Arg) -> Option<&'static str> {
        self.effective
            .iter()
            .find(|(flag, _)| option.get_long() == Some(flag))
            .map(|(_, help)| *help)
    }
}

/// The command with all options; each has a variable and may stand before or after the subcommand.
/// The help of `serve` shows all of them, that of another subcommand none or those that have an
/// effect on it; `shows_limits`: these alone.
fn command_with(shows_limits: bool) -> Command {
    let command = Cli::command().mut_args(|arg| match arg.get_long().map(variable) {
        Some(variable) => arg.env(variable).global(true).hide(true),
        None => arg,
    });
    let options: Vec<Arg> = command.get_arguments().cloned().collect();
    let shown = options.iter().cloned().map(|option| option.hide(false));
    let command = command.mut_subcommand("serve", |serve| serve.args(shown).after_help(VALUES));
    let command = command.help_template(TEMPLATE).before_help(ROOT);
    SUBCOMMANDS.iter().fold(command, |command, subcommand| {
        let is_hidden = subcommand.has_limits && !shows_limits;
        let limits = options
            .iter()
            .cloned()
            .map(|option| match subcommand.help_of(&option) {
                None => option.hide(true),
                Some("") => option.help_heading(None).hide(is_hidden),
                Some(help) => option.help_heading(None).help(help).hide(is_hidden),
            });
        let help_limits = Arg::new(HELP_LIMITS)
            .long(HELP_LIMITS)
            .action(ArgAction::SetTrue)
            .display_order(9);
        let help_limits = help_limits
            .help("Print the options that limit sizes, memory and threads")
            .hide(!subcommand.has_limits);
        command.mut_subcommand(subcommand.name, |own| {
            let own = if shows_limits {
                own.mut_args(|arg| arg.hide(true))
            } else {
                own
            };
            let own = if subcommand.has_limits {
                own.arg(help_limits.hide(shows_limits))
            } else {
                own
            };
            let own = own.args(limits).help_template(TEMPLATE);
            if shows_limits {
                own
            } else {
                own.before_help(subcommand.examples)
            }
        })
    })
}

/// The command with all options.
pub fn command() -> Command {
    command_with(false)
}

/// Whether the arguments ask for the limits of a subcommand: then their help, as an error of clap.
pub(super) fn limits_help(args: &[OsString]) -> Option<Error> {
    let subcommand = Subcommand::of(args).filter(|subcommand| subcommand.has_limits)?;
    let is_asked = args
        .iter()
        .any(|arg| arg.to_str().and_then(|arg| arg.strip_prefix("--")) == Some(HELP_LIMITS));
    is_asked.then(|| {
        command_with(true)
            .try_get_matches_from(["mlswarp", subcommand.name, "--help"])
            .err()
    })?
}

/// The options that have an effect on the subcommand that the arguments name; those of the server
/// without one.
pub(super) fn effective_flags(args: &[OsString]) -> Vec<String> {
    let command = Cli::command();
    let subcommand = Subcommand::of(args);
    let own = subcommand
        .and_then(|subcommand| command.find_subcommand(subcommand.name))
        .into_iter()
        .flat_map(Command::get_arguments);
    let of_server = command
        .get_arguments()
        .filter(|option| subcommand.is_none_or(|own| own.help_of(option).is_some()));
    own.chain(of_server)
        .filter_map(Arg::get_long)
        .map(str::to_owned)
        .collect()
}

/// Notes the options of the command line that have no effect on the subcommand. A variable may be
/// meant for another command.
pub(super) fn report_without_effect(matches: &ArgMatches, command: &Command) {
    let Some((name, given)) = matches.subcommand() else {
        return;
    };
    let Some(subcommand) = SUBCOMMANDS
        .iter()
        .find(|subcommand| subcommand.name == name)
    else {
        return;
    };
    for option in command
        .get_arguments()
        .filter(|option| subcommand.help_of(option).is_none())
    {
        if given.value_source(option.get_id().as_str()) == Some(ValueSource::CommandLine) {
            report::<()>(
                option.get_long().unwrap_or_default(),
                Err(format!("has no effect on `mlswarp {name}`; leave it out")),
            );
        }
    }
}
