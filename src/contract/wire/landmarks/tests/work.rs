//! The work of each reader: linear in the file, counted, and stopped soon after nobody wants the
//! result.

use std::cell::Cell;

use super::super::table::{LONGEST_FIELD, MOST_FIELDS, TableField, TableRows};
use super::super::{BesideFiles, Choice, Item, SourceText, Target};
use super::{LandmarkFiles, both};
use mlswarp::pixmap::Extent;

use crate::problem::Code;
use crate::wire::work::{BYTES_PER_CHECK, Work};

/// More than any file here has.
const MANY_BYTES: usize = 1 << 22;
/// What a file of each kind begins with, repeats, and ends with.
const GROWING: &[(&str, &str, &str)] = &[
    ("", "1.5,2.5\n", ""),
    ("", "1.5;2.5\n", ""),
    ("", "1.5 2.5\n", ""),
    ("", "1 2 ", "\n"),
    ("x,y\n", "\n", "1,2\n"),
    ("x,y\n", "\n ", "1,2\n"),
    ("# a\n", "#\n", "1,2\n"),
    ("", ",", ""),
    ("name,x,y\n", "\"a\"\"b\",1,2\n", ""),
    ("mapX,mapY,sourceX,sourceY,enable\n", "0,0,0,0,0\n", ""),
    (
        "mapX,mapY,sourceX,sourceY,enable\n0,0,1,-1,1\n",
        "0,0,0,0,1\n",
        "",
    ),
    ("", "Pt,false,0,0,0,0\n", ""),
    ("", "Pt,true,0,0,0,0\n", ""),
    ("", "Pt,true,0,0,Infinity,0\n", ""),
    ("version: 1\n{\n", "1 2\n", "}\n"),
    ("version: 1\n", "version: 1\n", "{\n1 2\n}\n"),
    ("3\n1 2\n3 4\n", "# a\n", "5 6\n"),
    ("", "LM=0\n", "LM=1\n1 2\n"),
    ("LM=1\n1 2\n", "A=\n", ""),
    ("# Markups fiducial file version = 4.11\n", "# a\n", ""),
    ("version: 1\n{\n", "\n", "1 2\n}\n"),
    ("3\n1 2\n3 4\n5 6\n99999999\n", "0\n3\n0 1 2\n", ""),
    ("LM=99999999\n", "1 2\n", ""),
    ("", "LM=1\n1 2\nIMAGE=a.jpg\n", ""),
    ("LM=1\n1 2\n", "COMMENT=a\n", ""),
    ("LM=1\n1 2\nCURVES=1\nPOINTS=99999999\n", "1 2\n", ""),
    ("index\n99999999\n", "1 2\n", ""),
    ("index,axis-0,axis-1\n", "0,1,2\n", ""),
    ("index,axis-0,axis-1,axis-2\n", "0,7,1,2\n0,8,1,2\n", ""),
    ("frame,success,x_0,y_0\n", "1,1,2,3\n", ""),
    ("scorer,a,a\nbodyparts,b,b\ncoords,x,y\n", "i.png,1,2\n", ""),
    (
        r#"{"movingPoints": ["#,
        "[1, 2], ",
        r#"[1, 2]], "fixedPoints": [[1, 2]]}"#,
    ),
    (
        r#"{"Transform": {"landmarks": {"names": [""#,
        "a",
        r#""], "movingPoints": [[1, 2]], "fixedPoints": [[1, 2]]}}}"#,
    ),
    (r#"{"p": ["#, "[1, 2], ", "[1, 2]]}"),
    (r#"{"p": [[1, 2]], "names": [""#, "a", "\"]}"),
    ("[", r#"{"x": 0.5, "y": 0.5}, "#, r#"{"x": 0.5, "y": 0.5}]"#),
    (
        "{",
        r#""a": 1, "#,
        r#""landmarks": [{"x": 0.5, "y": 0.5}]}"#,
    ),
    (
        r#"{"images": ["#,
        r#"{"id": 1, "file_name": "a"}, "#,
        r#"{}], "annotations": [{"keypoints": [1, 2, 2]}]}"#,
    ),
    (
        r#"{"images": [], "annotations": ["#,
        r#"{"id": 1, "image_id": 1, "keypoints": [1, 2, 2]}, "#,
        "{}]}",
    ),
    (
        r#"{"images": [], "annotations": [{"keypoints": ["#,
        "1, 2, 2, ",
        "1, 2, 2]}]}",
    ),
    (
        r#"{"categories": ["#,
        r#"{"id": 1}, "#,
        r#"{}], "annotations": [{"category_id": 1, "keypoints": [1, 2, 2]}]}"#,
    ),
    (
        "<dataset><image file='a'><box>",
        "<part name='a' x='1' y='2'/>\n",
        "</box></image></dataset>",
    ),
    (
        "<dataset>",
        "<image file='a'><box><part name='a' x='1' y='2'/></box></image>\n",
        "</dataset>",
    ),
    ("<dataset><!-- ", "> ", "--></dataset>"),
    ("<dataset>", "<!---->", "</dataset>"),
    ("<dataset a='", "a", "'></dataset>"),
    ("<dataset><image file='a' ", "b='c' ", "></image></dataset>"),
    ("<dataset>", "&", "</dataset>"),
    (
        "<annotations><image name='a'><points label='a' points='1,2",
        ";1,2",
        "'/></image></annotations>",
    ),
    (
        "<annotations><image name='a'>",
        "<points label='a' points='1,2'/>\n",
        "</image></annotations>",
    ),
    (
        "<annotations><image name='",
        "&amp;",
        "'></image></annotations>",
    ),
    (
        r#"{"type": "a", "body": {"features": ["#,
        r#"{"properties": {"resourceCoords": [1, 2]}}, "#,
        r#"{"properties": {"resourceCoords": [1, 2]}}]}}"#,
    ),
    (
        r#"{"type": "a", "items": ["#,
        r#"{"body": {"features": []}}, "#,
        r#"{"body": {"features": []}}]}"#,
    ),
    (
        r#"{"markups": [{"coordinateSystem": "IJK", "controlPoints": ["#,
        r#"{"position": [1, 2, 3]}, "#,
        r#"{"position": [1, 2, 3]}]}]}"#,
    ),
    (
        "# Markups fiducial file\n# CoordinateSystem = IJK\n",
        "0,1,2,3\n",
        "",
    ),
    ("# Markups fiducial file\n", "# a = b\n", ""),
    (
        r#"{"shapes": ["#,
        r#"{"label": "a", "points": [[1, 2]], "shape_type": "point"}, "#,
        r#"{}]}"#,
    ),
];
const LINE_ENDS: [&str; 4] = ["\n", "\r", "\r\n", "\n\r\r\n\r"];

/// Each file at about this number of bytes, with each line end.
fn files(size: usize) -> impl Iterator<Item = String> {
    GROWING.iter().flat_map(move |(start, row, end)| {
        let file = format!("{start}{}{end}", row.repeat(size / row.len()));
        let ends = if file.contains('\n') {
            &LINE_ENDS[..]
        } else {
            &LINE_ENDS[..1]
        };
        ends.iter().map(move |end| file.replace('\n', end))
    })
}

fn start(file: &str) -> String {
    file.chars().take(60).collect()
}

/// Processor time of this thread, ns, from the scheduler.
fn processor_time() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split(' ').next().unwrap().parse().unwrap()
}

/// The counted bytes and the processor time of reading.
fn cost(file: &LandmarkFiles) -> (usize, u64) {
    let (work, began) = (Work::new(&|| false), processor_time());
    let _ = file.read_counted(MANY_BYTES, &work);
    (work.bytes(), processor_time() - began)
}

/// What is wrong with the work of a file and of another one of twice its length.
fn wrong_growth(small: String, large: String) -> Vec<String> {
    let what = start(&small);
    let (small, large) = (both(small), both(large));
    let ((bytes, mut time), (more_bytes, mut more_time)) = (cost(&small), cost(&large));
    // Four times would be quadratic. A thread may be charged a few of the scheduler's ticks, of
    // 4 ms each, that others have used: what is quadratic takes far more.
    let is_slow = |time: u64, more: u64| more > 3 * time + 24_000_000;
    // Somebody else may have had the caches: the least of some attempts is the reader's own time.
    for _ in 0..4 {
        if is_slow(time, more_time) {
            time = time.min(cost(&small).1);
            more_time = more_time.min(cost(&large).1);
        }
    }
    let mut wrong = Vec::new();
    // Each byte is looked at some times, and no byte in vain: the count is what is done.
    let passes = more_bytes as f64 / large.bytes() as f64;
    if more_bytes > 2 * bytes + 8 * BYTES_PER_CHECK || !(0.9..=16.0).contains(&passes) {
        wrong.push(format!(
            "{what:?}: {bytes} bytes, of twice as much {more_bytes}, {passes:.1} passes"
        ));
    }
    if is_slow(time, more_time) {
        wrong.push(format!("{what:?}: {time} ns, of twice as much {more_time}"));
    }
    wrong
}

#[test]
fn the_work_of_each_reader_is_linear_whatever_ends_the_lines() {
    const SIZE: usize = 256 << 10;
    // No other test of this program takes as long, so it uses the processors itself.
    const THREADS: usize = 4;
    let wrong_of = |first: usize| -> Vec<String> {
        let pairs = files(SIZE).zip(files(2 * SIZE)).skip(first);
        let wrong = pairs.step_by(THREADS).flat_map(|(s, l)| wrong_growth(s, l));
        wrong.collect()
    };
    let wrong = std::thread::scope(|scope| {
        let threads: [_; THREADS] =
            std::array::from_fn(|first| scope.spawn(move || wrong_of(first)));
        threads.map(|thread| thread.join().unwrap()).concat()
    });
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn reading_stops_soon_after_nobody_wants_the_result() {
    const SIZE: usize = 128 << 10;
    // Several scans may have begun.
    const SOON: usize = 16 * BYTES_PER_CHECK;
    for file in files(SIZE) {
        let what = start(&file);
        let file = both(file);
        let questions = Cell::new(0);
        let count = || questions.replace(questions.get() + 1) == usize::MAX;
        let whole = Work::new(&count);
        let _ = file.read_counted(MANY_BYTES, &whole);
        // From the first scan of the file to the last.
        for part in 0..8 {
            let (last, asked) = (questions.get() * part / 8, Cell::new(0));
            let is_cancelled = || asked.replace(asked.get() + 1) >= last;
            let work = Work::new(&is_cancelled);
            let read = file.read_counted(MANY_BYTES, &work);
            assert_eq!(
                read.map(drop).unwrap_err().code,
                Code::Overloaded,
                "{what:?}"
            );
            let until = whole.bytes() * (part + 1) / 8;
            assert!(
                work.bytes() <= until + SOON,
                "{what:?}: {} bytes instead of {until}",
                work.bytes()
            );
        }
        assert!(whole.bytes() > 0);
    }
}

/// What precedes the items of an image, `*`, one of them, and what follows.
const ITEMS: [(&str, &str, &str); 3] = [
    (
        "<dataset><image file='*'>",
        "<box><part name='a' x='1' y='2'/></box>",
        "</image></dataset>",
    ),
    (
        "<annotations><image name='*'>",
        "<skeleton><points label='a' points='1,2'/></skeleton>",
        "</image></annotations>",
    ),
    (
        r#"{"images": [{"id": 1, "file_name": "*"}], "annotations": ["#,
        r#"{"id": 2, "image_id": 1, "keypoints": [1, 2, 2]}, "#,
        "{}]}",
    ),
];

/// Rows of an image with many long folders, and landmarks of these animals in turn.
fn deeplabcut(animals: &str) -> String {
    const ROWS: usize = 2;
    let (none, path) = (
        ",".repeat(2000),
        format!("{},", "a".repeat(1000)).repeat(2000),
    );
    let row = |folders: &str, cells: &str| format!("{folders}{}\n", [cells; 500].join(","));
    let header = [
        ("scorer", "e,e,e,e"),
        ("individuals", animals),
        ("bodyparts", "c,c,d,d"),
        ("coords", "x,y,x,y"),
    ];
    let header = header.map(|(name, cells)| row(&format!("{name}{none}"), cells));
    header.concat() + &row(&path, "1,2,3,4").repeat(ROWS)
}

/// What the items of an image have in common is looked at once for all of them.
#[test]
fn long_names_of_images_are_not_read_for_each_item() {
    let file = |text: String| LandmarkFiles {
        choice: Choice {
            item: Some(Item::Name("c".to_owned())),
            ..Choice::default()
        },
        ..both(text)
    };
    let of_image = |(start, item, end): (&str, &str, &str)| {
        let items = item.repeat((512 << 10) / item.len());
        ["a".to_owned(), "a".repeat(4000)]
            .map(|name| format!("{}{items}{end}", start.replace('*', &name)))
    };
    let of_rows = ["a,a,a,a", "a,a,b,b"].map(deeplabcut);
    for texts in ITEMS.map(of_image).into_iter().chain([of_rows]) {
        let what = start(&texts[0]);
        let files = texts.map(file);
        let least = |file: &LandmarkFiles| (0..3).map(|_| cost(file).1).min();
        let [few, many] = files.each_ref().map(|file| least(file).unwrap());
        assert!(
            many < 2 * few + 24_000_000,
            "{what}: {many} ns instead of {few}"
        );
    }
}

/// The JSON beside the files is checked once, and each search for fields is one more pass.
#[test]
fn the_json_beside_the_files_is_checked_once_and_its_scans_are_cancelled() {
    let others = "[1, 2], ".repeat(1 << 17);
    let json = format!(r#"{{"others": [{others}0], "item": 0}}"#);
    let landmarks = || both("1,2\n").read(1, &|| false).unwrap();
    let target = Target::Session(Extent::new(4, 3).unwrap());
    let asked = Cell::new(0_usize);
    let count = || asked.replace(asked.get() + 1) == usize::MAX;
    let beside = BesideFiles::new(json.as_bytes(), &count).unwrap();
    assert_eq!(beside.choice().unwrap().item, Some(Item::Index(0)));
    let fields = landmarks().into_fields(&beside, target).unwrap();
    assert!(fields.ends_with(br#", 0]}"#) && fields.starts_with(br#"{"p":[[1"#));
    let passes = beside.work.bytes() as f64 / json.len() as f64;
    assert!((3.9..4.1).contains(&passes), "{passes}");
    for most in (0..asked.get()).step_by(50) {
        let left = Cell::new(most);
        let cancelled = || left.replace(left.get().saturating_sub(1)) == 0;
        let beside = BesideFiles::new(json.as_bytes(), &cancelled);
        let fields = beside.and_then(|beside| {
            beside.choice()?;
            landmarks().into_fields(&beside, target)
        });
        assert_eq!(fields.unwrap_err().code, Code::Overloaded, "{most}");
    }
}

/// A header has three rows in memory, each of which may be as long as a row can be.
#[test]
fn the_longest_rows_are_within_what_reading_reserves() {
    let row = vec!["a".repeat(LONGEST_FIELD - 1); MOST_FIELDS].join(",");
    // The first row is a line, and those are shorter.
    let text = format!("a,b\n{row}\n");
    let source = SourceText {
        text: &text,
        start: 0,
        work: &Work::new(&|| false),
    };
    let mut rows = TableRows::new(source).unwrap();
    let [_, row] = [(); 2].map(|()| rows.next_row().unwrap().unwrap());
    let bytes = |field: &TableField| size_of::<TableField>() + field.text.capacity();
    let bytes: usize = row.fields.iter().map(bytes).sum();
    let files = both(text.repeat(4));
    assert!(3 * bytes as u64 <= files.reading_bytes(0), "{bytes}");
}

/// Rows that are left out take the place of those that count.
#[test]
fn rows_without_effect_are_limited_as_well() {
    for row in [
        "0,0,0,0,0\n",
        "Pt,false,0,0,0,0\n",
        "Pt,true,Infinity,0,0,Infinity\n",
    ] {
        let head = if row.starts_with('0') {
            "mapX,mapY,sourceX,sourceY,enable\n"
        } else {
            ""
        };
        let file = |rows: usize| {
            both(format!(
                "{head}{}{}",
                row.repeat(rows - 1),
                row.replace("0,0\n", "0,1\n").replace("false", "true")
            ))
        };
        let refused = file(super::MAX_COLUMNS + 1)
            .read(super::MAX_COLUMNS, &|| false)
            .unwrap_err();
        assert_eq!(
            (refused.code, refused.what),
            (Code::TooLarge, Some("handle_columns")),
            "{row}"
        );
    }
}
