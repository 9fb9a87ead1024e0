//! The memory that this process may use: that of the machine, or what its control groups allow
//! (Linux), whichever is less.

use std::fs;
use std::path::{Path, PathBuf};

pub(super) fn bytes() -> u64 {
    const IF_UNKNOWN: u64 = 2 << 30;
    least(&|path| fs::read_to_string(path).ok()).unwrap_or(IF_UNKNOWN)
}

fn least(read: &dyn Fn(&Path) -> Option<String>) -> Option<u64> {
    let machine = read(Path::new("/proc/meminfo")).and_then(|text| kib_field(&text, "MemTotal:"));
    let groups = read(Path::new("/proc/self/cgroup")).unwrap_or_default();
    let limits = groups
        .lines()
        .flat_map(limit_files)
        .filter_map(|file| read(&file)?.trim().parse().ok());
    limits.chain(machine).min()
}

/// The bytes of a line such as `MemTotal:       24612345 kB`.
pub(crate) fn kib_field(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim()
        .strip_suffix("kB")?
        .trim()
        .parse::<u64>()
        .ok()?
        .checked_mul(1024)
}

/// The files with the limits of a group and of its ancestors: `0::/a/b` of version 2,
/// `5:memory:/a/b` of version 1. A container often sees only the limit at the root.
fn limit_files(line: &str) -> Vec<PathBuf> {
    let mut fields = line.splitn(3, ':').skip(1);
    let (Some(controllers), Some(path)) = (fields.next(), fields.next()) else {
        return Vec::new();
    };
    let (root, file) = match controllers {
        "" => ("/sys/fs/cgroup", "memory.max"),
        _ if controllers
            .split(',')
            .any(|controller| controller == "memory") =>
        {
            ("/sys/fs/cgroup/memory", "memory.limit_in_bytes")
        }
        _ => return Vec::new(),
    };
    Path::new(path.trim_start_matches('/'))
        .ancestors()
        .map(|group| Path::new(root).join(group).join(file))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    fn of(files: &[(&str, &str)]) -> Option<u64> {
        let files: HashMap<PathBuf, String> = files
            .iter()
            .map(|(path, text)| ((*path).into(), (*text).to_owned()))
            .collect();
        least(&|path| files.get(path).cloned())
    }

    const MACHINE: (&str, &str) = ("/proc/meminfo", "MemFree: 1 kB\nMemTotal:       1000 kB\n");

    #[test]
    fn the_least_of_machine_and_groups_counts() {
        assert_eq!(of(&[MACHINE]), Some(1_024_000));
        assert_eq!(of(&[]), None);
        let version_2 = ("/proc/self/cgroup", "0::/service/one\n");
        assert_eq!(
            of(&[
                MACHINE,
                version_2,
                ("/sys/fs/cgroup/service/one/memory.max", "max\n")
            ]),
            Some(1_024_000)
        );
        assert_eq!(
            of(&[
                MACHINE,
                version_2,
                ("/sys/fs/cgroup/service/one/memory.max", "5000\n")
            ]),
            Some(5000)
        );
        assert_eq!(
            of(&[
                MACHINE,
                version_2,
                ("/sys/fs/cgroup/service/memory.max", "7000\n")
            ]),
            Some(7000)
        );
        assert_eq!(
            of(&[MACHINE, version_2, ("/sys/fs/cgroup/memory.max", "9000\n")]),
            Some(9000)
        );
        let version_1 = (
            "/proc/self/cgroup",
            "3:cpu,cpuacct:/x\n5:memory:/docker/1\n",
        );
        assert_eq!(
            of(&[
                MACHINE,
                version_1,
                ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "8000\n")
            ]),
            Some(8000)
        );
        assert_eq!(
            of(&[
                MACHINE,
                version_1,
                (
                    "/sys/fs/cgroup/memory/memory.limit_in_bytes",
                    "9223372036854771712\n"
                )
            ]),
            Some(1_024_000)
        );
    }

    #[test]
    fn this_machine_has_some() {
        assert!(bytes() > 64 << 20);
    }
}
