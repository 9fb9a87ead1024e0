//! Sizes and spans of time as people write them: `32MiB`, `512M`, `1_000`, `15m`, `2.5s`. Pure parsing, no I/O.
//! K, M, G and KiB, MiB, GiB are powers of 1024 alike; KB, MB, GB are powers of 1000.

use std::time::Duration;

/// Bytes.
pub(crate) fn bytes(text: &str) -> Result<u64, String> {
    let (number, unit) = split(text);
    let scale: u64 = match unit.to_ascii_lowercase().as_str() {
        "" | "b" => 1,
        "k" | "ki" | "kib" => 1 << 10,
        "m" | "mi" | "mib" => 1 << 20,
        "g" | "gi" | "gib" => 1 << 30,
        "kb" => 1_000,
        "mb" => 1_000_000,
        "gb" => 1_000_000_000,
        _ => return Err(format!("`{text}` is not a size such as 32MiB, 512K or 1048576")),
    };
    scaled(&number, scale).ok_or_else(|| format!("`{text}` is not a size such as 32MiB, 512K or 1048576"))
}

/// A number of things: `50M` is fifty million.
pub(crate) fn count(text: &str) -> Result<u64, String> {
    let (number, unit) = split(text);
    let scale: u64 = match unit {
        "" => 1,
        "k" | "K" => 1_000,
        "m" | "M" => 1_000_000,
        _ => return Err(format!("`{text}` is not a whole number such as 10000 or 50M")),
    };
    scaled(&number, scale).ok_or_else(|| format!("`{text}` is not a whole number such as 10000 or 50M"))
}

/// A span of time, longer than nothing and at most a year.
pub(crate) fn span(text: &str) -> Result<Duration, String> {
    let wrong = || format!("`{text}` is not a time such as 500ms, 30s, 15m or 2h");
    let (number, unit) = split(text);
    let seconds = match unit {
        "ms" => 0.001,
        "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        "d" => 86400.0,
        _ => return Err(wrong()),
    } * number.parse::<f64>().map_err(|_| wrong())?;
    if !(0.001..=366.0 * 86400.0).contains(&seconds) {
        return Err(format!("`{text}` is not between 1ms and 366d"));
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// A span of time that may also be nothing.
pub(crate) fn pause(text: &str) -> Result<Duration, String> {
    if text.trim() == "0s" { Ok(Duration::ZERO) } else { span(text) }
}

fn split(text: &str) -> (String, &str) {
    let text = text.trim();
    let end = text.find(|c: char| !(c.is_ascii_digit() || c == '.' || c == '_')).unwrap_or(text.len());
    (text[..end].replace('_', ""), text[end..].trim_start())
}

/// Exact for whole numbers; a fraction is rounded down to a whole byte.
fn scaled(number: &str, scale: u64) -> Option<u64> {
    if let Ok(whole) = number.parse::<u64>() {
        return whole.checked_mul(scale);
    }
    let (whole, fraction) = number.split_once('.')?;
    let whole = whole.parse::<u64>().ok()?.checked_mul(scale)?;
    let digits = u32::try_from(fraction.len()).ok().filter(|n| (1..=9).contains(n))?;
    let part = u128::from(fraction.parse::<u64>().ok()?) * u128::from(scale) / 10u128.pow(digits);
    whole.checked_add(u64::try_from(part).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_as_people_write_them() {
        for (text, value) in [("0", 0), ("1_000", 1000), ("32MiB", 32 << 20), ("512M", 512 << 20), ("64 KiB", 64 << 10), ("1.5g", 3 << 29)]
        {
            assert_eq!(bytes(text), Ok(value), "{text}");
        }
        assert_eq!(bytes("2MB"), Ok(2_000_000));
        for text in ["", "MiB", "-1", "1e6", "12x", "1.", "99999999999G", "1.2.3M"] {
            assert!(bytes(text).is_err(), "{text}");
        }
    }

    #[test]
    fn counts_are_decimal() {
        assert_eq!(count("50M"), Ok(50_000_000));
        assert_eq!(count("10_000"), Ok(10_000));
        assert!(count("50MiB").is_err());
    }

    #[test]
    fn spans_need_a_unit() {
        assert_eq!((pause("0s"), pause("5s")), (Ok(Duration::ZERO), Ok(Duration::from_secs(5))));
        assert_eq!(span("15m"), Ok(Duration::from_secs(900)));
        assert_eq!(span("2.5s"), Ok(Duration::from_millis(2500)));
        assert_eq!(span("500ms"), Ok(Duration::from_millis(500)));
        for text in ["30", "", "s", "-1s", "0s", "1e9s", "9999999d"] {
            assert!(span(text).is_err(), "{text}");
        }
    }
}
