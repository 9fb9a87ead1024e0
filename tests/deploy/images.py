"""The images: base images made from Debian and this machine, and deploy/Dockerfile on top of
them."""

import contextlib
import hashlib
import inspect
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from commands import AS_ROOT, CACHE, ROOT, Failure, install, run, text, timed, where

SUITE = "bookworm"
BUILDER_NAME = "mlswarp-test/builder"
SERVICES_NAME = "mlswarp-test/services"
SYSTEMD_NAME = "mlswarp-test/systemd"
IMAGE = "mlswarp-test/mlswarp"


def has(engine, tag):
    """Whether the image exists; if not, removes older versions."""
    if engine("image", "inspect", tag, check=False).returncode == 0:
        return True
    for stale in engine.text("image", "ls", "--quiet", tag.partition(":")[0]).split():
        engine("image", "rm", "--force", stale, check=False)
    return False


@contextlib.contextmanager
def planted(name):
    """A temporary empty tree for an image."""
    tree = Path(tempfile.mkdtemp(prefix=f"{name}-", dir=CACHE))
    try:
        yield tree
    finally:
        run(*AS_ROOT, "rm", "-rf", "--one-file-system", tree, check=False)


def take(engine, tree, tag, *settings):
    """The tree as an image with those settings."""
    tar = subprocess.Popen(
        [*AS_ROOT, "tar", "-C", tree, "--numeric-owner", "-c", "."], stdout=subprocess.PIPE
    )
    engine(
        "import",
        *(part for setting in settings for part in ("--change", setting)),
        "-",
        tag,
        stdin=tar.stdout,
    )
    tar.stdout.close()
    if tar.wait() != 0:
        engine("image", "rm", tag, check=False)
        raise Failure(f"the tree of {tag} could not be read")


def builder_image(engine):
    """The base of the build stage: Debian with a C toolchain, and the Rust and cargo settings of
    this machine."""
    given = os.environ.get("MLSWARP_TEST_BUILDER")
    if given:
        return given
    rustc, cargo = where("rustc"), where("cargo")
    if not rustc or not cargo:
        raise Failure("no Rust toolchain on this machine (rustc and cargo must be in PATH)")
    sysroot = Path(text(rustc, "--print", "sysroot"))
    version = text(rustc, "-vV")
    target = next(line.split()[1] for line in version.splitlines() if line.startswith("host:"))
    certificates = Path("/etc/ssl/certs/ca-certificates.crt")
    settings = Path(os.environ.get("CARGO_HOME") or Path.home() / ".cargo") / "config.toml"
    key = hashlib.sha256((SUITE + version + inspect.getsource(builder_image)).encode())
    for file in (certificates, settings):
        key.update(file.read_bytes() if file.is_file() else b"-")
    tag = f"{BUILDER_NAME}:{key.hexdigest()[:16]}"
    if has(engine, tag):
        return tag
    if where("debootstrap") is None:
        install("debootstrap")
    with planted("builder") as tree:
        with timed(f"making a Debian {SUITE} with gcc"):
            run(
                *AS_ROOT,
                where("debootstrap"),
                "--variant=minbase",
                "--include=gcc,libc6-dev,ca-certificates",
                SUITE,
                tree,
            )
        with timed("adding Rust to it"):
            rust = tree / "usr/local/rust"
            run(
                *AS_ROOT,
                "mkdir",
                "-p",
                rust / "bin",
                rust / "lib/rustlib",
                tree / "usr/local/cargo",
            )
            run(*AS_ROOT, "cp", "-a", sysroot / "bin/rustc", sysroot / "bin/cargo", rust / "bin")
            run(
                *AS_ROOT,
                "cp",
                "-a",
                *(p for p in (sysroot / "lib").iterdir() if ".so" in p.name),
                rust / "lib",
            )
            run(*AS_ROOT, "cp", "-a", sysroot / "lib/rustlib" / target, rust / "lib/rustlib")
            # Copy the network settings of cargo.
            for file, place in ((certificates, "etc/ssl/certs/"), (settings, "usr/local/cargo/")):
                if file.is_file():
                    run(*AS_ROOT, "cp", "-L", file, tree / place)
            for unused in (
                "var/cache/apt",
                "var/lib/apt/lists",
                "usr/share/doc",
                "usr/share/man",
                "usr/share/locale",
            ):
                run(*AS_ROOT, "rm", "-rf", tree / unused)
            take(
                engine,
                tree,
                tag,
                "ENV PATH=/usr/local/rust/bin:/usr/sbin:/usr/bin:/sbin:/bin",
                "ENV CARGO_HOME=/usr/local/cargo",
            )
    return tag


# Of Debian's packages, what compose.yaml's images have: programs by the names that it calls them,
# and directories with their owners.
SERVICES = {
    "usr/local/sbin/haproxy": "haproxy",
    "usr/local/bin/valkey-server": "redis-server",
    "usr/local/bin/valkey-cli": "redis-cli",
    "bin/prometheus": "prometheus",
    "bin/wget": "busybox",
    "bin/sleep": "busybox",
}
OWNED = {"data": "999:1000", "prometheus": "65534:65534"}


def services_image(engine):
    """The proxy, the store and Prometheus in one image, with the libraries that they need and
    nothing else."""
    programs = {place: Path(where(name) or name).resolve() for place, name in SERVICES.items()}
    key = hashlib.sha256(
        inspect.getsource(services_image).encode() + repr((SERVICES, OWNED)).encode()
    )
    for program in programs.values():
        key.update(program.read_bytes())
    tag = f"{SERVICES_NAME}:{key.hexdigest()[:16]}"
    if has(engine, tag):
        return tag
    with planted("services") as tree:
        for place, program in programs.items():
            # Each library where the loader looks for it, which `ldd` says.
            libraries = [word for word in text("ldd", program).split() if word.startswith("/")]
            for file, at in (
                (program, place),
                *((Path(library), library.lstrip("/")) for library in libraries),
            ):
                (tree / at).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(file, tree / at)
        for directory, owner in OWNED.items():
            (tree / directory).mkdir()
            run(*AS_ROOT, "chown", owner, tree / directory)
        take(
            engine,
            tree,
            tag,
            "ENV PATH=/usr/local/sbin:/usr/local/bin:/bin",
            'CMD ["haproxy", "-f", "/usr/local/etc/haproxy/haproxy.cfg"]',
        )
    return tag


def systemd_image(engine):
    """A Debian that systemd boots, with curl and openssl."""
    key = hashlib.sha256((SUITE + inspect.getsource(systemd_image)).encode())
    tag = f"{SYSTEMD_NAME}:{key.hexdigest()[:16]}"
    if has(engine, tag):
        return tag
    if where("debootstrap") is None:
        install("debootstrap")
    with planted("systemd") as tree, timed(f"making a Debian {SUITE} with systemd"):
        run(
            *AS_ROOT,
            where("debootstrap"),
            "--variant=minbase",
            "--include=systemd,systemd-sysv,ca-certificates,curl,openssl",
            SUITE,
            tree,
        )
        run(
            *AS_ROOT,
            "rm",
            "-rf",
            tree / "var/cache/apt",
            tree / "var/lib/apt/lists",
            tree / "usr/share/doc",
            tree / "usr/share/man",
        )
        take(engine, tree, tag)
    return tag


def build_options(engine):
    """Options of every build of deploy/Dockerfile: the same ones everywhere, so that the second
    build finds each layer of the first in the cache. The base of this machine, its network and
    proxies. Only the long form, which measures and compares programs, optimises as a release."""
    settings = [f"BUILDER={builder_image(engine)}"]
    if not os.environ.get("MLSWARP_TESTS_FULL"):
        settings += ["LTO=off", "OPT_LEVEL=1"]
    settings += [
        f"{name}={value}"
        for name, value in os.environ.items()
        if name.lower() in ("http_proxy", "https_proxy", "no_proxy", "all_proxy")
    ]
    return ["--network=host", *(part for one in settings for part in ("--build-arg", one))]


def copied(place):
    """A copy of the tracked files, which the commands may write into."""
    names = (
        run("git", "-C", ROOT, "ls-files", "-z", "--cached", "--others", "--exclude-standard")
        .stdout.decode()
        .split("\0")
    )
    for name in filter(None, names):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, place / name, follow_symlinks=False)
    return place


def build(engine, tag=IMAGE, *options):
    """Builds deploy/Dockerfile unchanged."""
    given = build_options(engine)
    with (
        timed(
            f"building deploy/Dockerfile ({'BuildKit' if engine.buildkit else 'the old builder'})"
        ),
        tempfile.TemporaryDirectory(dir=CACHE) as place,
    ):
        files = copied(Path(place) / "src")
        engine.build(*given, *options, "-f", files / "deploy/Dockerfile", "-t", tag, files)


def program(engine, place, tag=IMAGE):
    """Copies the program out of an image; it is static, so it runs here too."""
    name = engine.text("create", tag)
    try:
        engine("cp", f"{name}:/mlswarp", place)
    finally:
        engine("rm", name, check=False)
    return place
