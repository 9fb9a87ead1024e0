"""The dialog "Average or morph": pictures with their landmark files, the sliders, what is saved,
and what is said of files that cannot be used."""

import base64
import io
import json
import subprocess
import zipfile

import pytest
from PIL import Image, ImageChops

from support import BLUE, GREEN, RED, Fingers, Server, discs, tell
from test_files import pts

FIRST = [RED, GREEN, BLUE, (40, 260), (360, 270)]
SECOND = [(130, 110), (300, 120), (210, 180), (40, 260), (360, 270)]


@pytest.fixture
def faces(tmp_path):
    """Two pictures of other colours, each with its landmark file."""
    discs(tmp_path / "anna.png")
    turned = Image.open(tmp_path / "anna.png").rotate(180)
    turned.save(tmp_path / "bert.png")
    (tmp_path / "anna.pts").write_bytes(pts(FIRST))
    (tmp_path / "bert.pts").write_bytes(pts(SECOND))
    return tmp_path


def files(folder, *names):
    return [folder / name for name in names or ("anna.png", "anna.pts", "bert.png", "bert.pts")]


def blended(visit):
    """Waits for the picture of what the sliders show; returns its pixels."""
    visit.body("[data-blend=ready]")
    address = visit.page.evaluate(
        """() => {
          const picture = document.querySelector("#blend-picture");
          const canvas = document.createElement("canvas");
          [canvas.width, canvas.height] = [picture.naturalWidth, picture.naturalHeight];
          canvas.getContext("2d").drawImage(picture, 0, 0);
          return canvas.toDataURL();
        }"""
    )
    return Image.open(io.BytesIO(base64.b64decode(address.split(",")[1]))).convert("RGB")


@pytest.fixture
def open_dialog(visit, faces):
    visit.page.click("#blend-open")
    visit.body("[data-blend=empty]")
    visit.page.set_input_files("#blend-files", files(faces))
    blended(visit)
    return visit


def largest(a, b):
    return max(high for _, high in ImageChops.difference(a, b).getextrema())


def slide(visit, **shares):
    for name, share in shares.items():
        visit.page.fill(f"#blend-{name}", str(share))


def test_two_pictures_are_averaged_and_the_sliders_lead_to_either(open_dialog, faces):
    visit = open_dialog
    assert visit.text("blend-said-of") == "2 pictures, 5 landmarks each."
    assert visit.text("blend-shape-value") == "50 %" and visit.text("blend-note").startswith(
        "0 % is anna.png, 100 % bert.png."
    )
    alt = visit.page.get_attribute("#blend-picture", "alt")
    assert alt == "Blend of anna.png and bert.png: shape 50 %, colours 50 %"
    average = blended(visit)
    slide(visit, shape=0)
    assert visit.page.input_value("#blend-colour") == "0"
    first = blended(visit)
    assert largest(first, Image.open(faces / "anna.png").convert("RGB")) == 0
    # Each slider alone.
    visit.page.uncheck("#blend-together")
    slide(visit, colour=100)
    colours = blended(visit)
    slide(visit, shape=50, colour=0)
    shape = blended(visit)
    assert all(largest(a, b) > 50 for a, b in ((first, colours), (first, shape), (shape, average)))
    visit.page.click("#blend-average")
    assert largest(blended(visit), average) == 0


def test_one_file_has_the_landmarks_of_all_pictures(visit, faces):
    """tpsDig writes one file for a folder of pictures; y is up."""
    visit.expects("422")
    specimen = "LM=5\n{}\nIMAGE={}\nID={}\n"
    rows = ["\n".join(f"{x} {300 - y}" for x, y in places) for places in (FIRST, SECOND)]
    names = ("anna.jpg", "bert.jpg")
    text = "".join(specimen.format(row, name, k) for k, (row, name) in enumerate(zip(rows, names)))
    (faces / "faces.tps").write_text(text)
    visit.page.click("#blend-open")
    visit.page.set_input_files("#blend-files", files(faces, "anna.png", "bert.png", "faces.tps"))
    average = blended(visit)
    assert visit.text("blend-said-of") == "2 pictures, 5 landmarks each."
    # As with a file for each.
    for name in ("anna.pts", "bert.pts"):
        visit.page.set_input_files("#blend-files", files(faces, name))
        blended(visit)
    visit.page.wait_for_selector("#blend-list small:text-matches('from bert.pts')")
    assert largest(blended(visit), average) <= 1


def test_another_method_makes_another_picture(open_dialog):
    visit = open_dialog
    usual = blended(visit)
    assert visit.page.input_value("#blend-method") == "affine"
    options = visit.page.locator("#blend-method option")
    usable = [name for name in options.all_inner_texts() if name != "Morph"]
    assert usable == ["Rigid", "Similarity", "Affine", "Spline", "Global"]
    assert options.filter(has_text="Morph").is_disabled()
    visit.page.select_option("#blend-method", "tps")
    assert visit.text("blend-method-note").startswith("Bends the whole picture")
    assert largest(blended(visit), usual) > 50
    visit.page.select_option("#blend-method", "affine")
    assert largest(blended(visit), usual) == 0


def test_a_slider_that_moves_fast_shows_the_last_value(open_dialog):
    visit = open_dialog
    for share in range(-50, 151, 10):
        slide(visit, shape=share)
    slide(visit, shape=70)
    assert visit.text("blend-shape-value") == "70 %"
    last = blended(visit)
    assert "shape 70 %" in visit.page.get_attribute("#blend-picture", "alt")
    slide(visit, shape=0)
    blended(visit)
    slide(visit, shape=70)
    assert largest(blended(visit), last) == 0


def test_pictures_with_landmarks_that_are_dropped_together_open_the_dialog(visit, faces):
    carried = [(path.name, "", path.read_bytes()) for path in files(faces)]
    tell(visit, ["dragover", "drop"], *carried)
    blended(visit)
    # More files are added to those that are there; what is not used is named.
    tell(
        visit,
        ["dragover", "drop"],
        ("carl.png", "image/png", (faces / "anna.png").read_bytes()),
        ("notes.docx", "", b"no"),
    )
    visit.page.wait_for_selector("#blend-said-of:text-matches('2 of 3 pictures can be used')")
    assert "Not used: notes.docx." in visit.text("blend-said-of")
    note = visit.page.locator("#blend-list li").nth(2).locator("small")
    assert note.inner_text() == "Needs its landmark file, such as carl.pts or carl.csv"
    # A file of another name goes to the picture without one; three are averaged.
    tell(visit, ["dragover", "drop"], ("third.pts", "", pts(FIRST)))
    visit.page.wait_for_selector("#blend-said-of:text-matches('3 pictures, 5 landmarks each')")
    assert visit.text("blend-shape-value") == "67 %"
    blended(visit)
    visit.page.click("#blend-list button[aria-label='Remove carl.png']")
    visit.page.wait_for_selector("#blend-said-of:text-matches('2 pictures')")
    assert visit.page.evaluate("document.activeElement.ariaLabel") == "Remove bert.png"
    blended(visit)
    visit.page.keyboard.press("Escape")
    visit.body("[data-blend=closed]")
    # The page behind is as it was, and two pictures without landmark files do not begin a blend.
    assert visit["state"] == "empty"
    two = [("a.png", "image/png", (faces / "anna.png").read_bytes())]
    tell(visit, ["dragover", "drop"], *two)
    visit.body("[data-state=ready][data-blend=closed]")


def test_one_picture_and_its_mirror_image_are_symmetric(visit, faces):
    visit.page.click("#blend-open")
    visit.page.set_input_files("#blend-files", files(faces, "anna.png", "anna.pts"))
    visit.page.wait_for_selector("#blend-said-of:text-matches('1 picture, 5 landmarks each')")
    assert not visit.page.locator("#blend-controls").is_visible()
    (faces / "anna.csv").write_text(
        "name,x,y\nleft_a,60,60\nright_a,340,60\nmiddle,200,220\nleft_b,40,260\nright_b,360,270\n"
    )
    visit.page.set_input_files("#blend-files", files(faces, "anna.csv"))
    visit.page.check("#blend-mirror")
    symmetric = blended(visit)
    assert largest(symmetric, symmetric.transpose(Image.Transpose.FLIP_LEFT_RIGHT)) <= 1
    assert visit.page.locator("#blend-shape").is_disabled()


@pytest.mark.parametrize("kind", ["png", "jpeg", "apng", "gif", "zip"])
def test_files_and_commands_have_the_same_bytes(open_dialog, faces, kind):
    visit = open_dialog
    slide(visit, shape=80)
    visit.page.select_option("#blend-file", kind)
    with visit.page.expect_download() as download:
        visit.page.click("#blend-save")
    name, saved = download.value.suggested_filename, open(download.value.path(), "rb").read()
    assert name == f"anna-blend.{ {'jpeg': 'jpg', 'apng': 'png'}.get(kind, kind) }"
    visit.page.click("#blend-curl")
    visit.page.wait_for_selector("#blend-said:text-matches('copied')")
    line = visit.page.evaluate("navigator.clipboard.readText()")
    done = subprocess.run(
        ["sh", "-euc", line], cwd=faces, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and not done.stderr, (line, done.stderr)
    assert (faces / name).read_bytes() == saved
    if kind == "zip":
        archive = zipfile.ZipFile(io.BytesIO(saved))
        frames = json.loads(archive.read("report.json"))["frames"]
        assert len(frames) == 7 and frames[0]["colour"] == [1, 0]
        assert [round(share, 9) for share in frames[6]["shape"]] == [0.2, 0.8]
    elif kind != "jpeg":
        image = Image.open(io.BytesIO(saved))
        assert getattr(image, "n_frames", 1) == (1 if kind == "png" else 7)


def test_files_that_cannot_be_used_are_told_and_removed(visit, faces):
    visit.expects("422")
    visit.page.click("#blend-open")
    (faces / "bert.pts").write_bytes(pts(SECOND[:3]))
    (faces / "carl.png").write_bytes(b"\x89PNG\r\n\x1a\nbroken")
    (faces / "carl.pts").write_bytes(pts(FIRST))
    (faces / "dora.png").write_bytes((faces / "anna.png").read_bytes())
    (faces / "dora.csv").write_text("x,y\n1,ten\n")
    more = files(faces, "carl.png", "carl.pts", "dora.png", "dora.csv")
    visit.page.set_input_files("#blend-files", [*files(faces), *more])
    # Two of them do not match, which the server says with the picture.
    visit.body("[data-blend=error]")
    problem = visit.text("blend-problem-text")
    assert "this shape has 3 handles, but the first one has 5" in problem.lower().replace(
        "\n", " "
    ), problem
    notes = visit.page.locator("#blend-list small").all_inner_texts()
    assert notes[2] and notes[3].startswith("In dora.csv, line 2"), notes
    for name in ("dora.png", "carl.png"):
        visit.page.click(f"#blend-list button[aria-label='Remove {name}']")
    (faces / "bert.pts").write_bytes(pts(SECOND))
    visit.page.set_input_files("#blend-files", files(faces, "bert.pts"))
    blended(visit)
    assert not visit.page.locator("#blend-problem").is_visible()


def test_a_server_that_has_forgotten_the_pictures_gets_them_again(visits, browser, faces):
    server = Server("--session-idle", "1s")
    try:
        visit = visits(server)
        visit.expects("404", "410")
        visit.page.click("#blend-open")
        visit.page.set_input_files("#blend-files", files(faces))
        blended(visit)
        visit.page.wait_for_timeout(2500)
        slide(visit, shape=20)
        visit.body("[data-blend=ready]")
        visit.page.wait_for_selector("#blend-picture[alt*='shape 20 %']")
        blended(visit)
    finally:
        server.stop()


def test_the_keyboard_reaches_everything(open_dialog):
    visit = open_dialog
    visit.page.focus("#blend-close")
    reached = []
    for _ in range(20):
        visit.keys("Tab")
        reached.append(visit.page.evaluate("document.activeElement.id"))
    for id in ("blend-pick", "blend-mirror", "blend-shape", "blend-colour", "blend-average"):
        assert id in reached, reached
    visit.page.focus("#blend-shape")
    visit.keys("ArrowRight", "ArrowRight")
    assert visit.text("blend-shape-value") == "52 %"
    blended(visit)
    visit.page.focus("#blend-file")
    visit.page.select_option("#blend-file", "gif")
    visit.page.fill("#blend-frames", "1")
    visit.page.focus("#blend-save")
    visit.keys("Enter")
    assert visit.page.locator("#blend-frames:invalid").count() == 1
    visit.keys("Escape")
    visit.body("[data-blend=closed]")
    assert visit.page.evaluate("document.activeElement.id") == "blend-open"


def test_a_phone_shows_all_of_it(visits, faces):
    visit = visits(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    Fingers(visit).tap(*centre(visit, "#blend-open"))
    visit.page.set_input_files("#blend-files", files(faces))
    blended(visit)
    wide = visit.page.evaluate("document.querySelector('#blend-form').scrollWidth")
    assert wide <= 390, wide
    visit.page.locator("#blend-save").scroll_into_view_if_needed()
    visit.keep("blend-phone")


def centre(visit, selector):
    node = visit.page.locator(selector)
    node.scroll_into_view_if_needed()
    box = node.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
