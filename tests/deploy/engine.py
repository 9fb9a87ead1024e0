"""The Docker engine."""

import os
import subprocess
import tempfile
import time
from pathlib import Path

from commands import AS_ROOT, CACHE, Failure, install, run, say, text, where


class Engine:
    """A Docker engine: a running one, or one started here and ended by `stop`."""

    # The containers use the loopback of the host or no network, so the network of the machine is
    # unchanged.
    NETWORK = ["--bridge=none", "--iptables=false", "--ip-forward=false", "--ip-masq=false"]

    def __init__(self):
        self.prefix, self.host, self.daemon, self.pid, self.scratch = [], [], None, None, None

    def open(self):
        self.own = not self._answers()
        if self.own:
            if where("dockerd") is None:
                install("docker.io")
            # Installing starts the engine where a service manager runs.
            self.own = not self._answers()
        self.client, self.buildkit = self._client()
        if self.own:
            self._start()
        version, storage = (
            self.text("version", "--format", "{{.Server.Version}}"),
            self.text("info", "--format", "{{.Driver}}"),
        )
        say(
            f"engine {version}, storage {storage}, "
            f"{'started here' if self.own else 'found running'}"
        )

    def _answers(self):
        client = where("docker")
        for prefix in ([], AS_ROOT) if client else ():
            done = run(*prefix, client, "info", "--format", "{{.ServerVersion}}", check=False)
            # A client without an engine may exit with 0 and print only an error.
            if done.returncode == 0 and done.stdout.strip():
                self.prefix = prefix
                return True
        return False

    def _client(self):
        """A client that builds as users build (BuildKit: built in before 23, a plugin since), or
        any client with the old builder."""
        found = [
            c
            for c in dict.fromkeys((where("docker"), "/usr/bin/docker"))
            if c and os.path.exists(c)
        ]
        for client in found:
            version = text(client, "version", "--format", "{{.Client.Version}}", check=False) or "0"
            if (
                int(version.split(".")[0]) < 23
                or run(client, "buildx", "version", check=False).returncode == 0
            ):
                return client, True
        if not found:
            raise Failure("no docker client after installing docker.io")
        return found[0], False

    def _start(self):
        self.prefix = AS_ROOT
        self.scratch = Path(tempfile.mkdtemp(prefix="mlswarp-engine-"))
        socket_path, pidfile, log = (self.scratch / n for n in ("docker.sock", "docker.pid", "log"))
        self.host = ["--host", f"unix://{socket_path}"]
        # As root, the engine ends with this test even if the test is killed (sudo does not forward
        # the signal).
        command = [
            *AS_ROOT, "setpriv", "--pdeathsig=TERM", *self._start_in(), where("dockerd"),
            *self.host, "--data-root", self._data(),
            "--exec-root", self.scratch / "exec", "--pidfile", pidfile, *self.NETWORK,
        ]  # fmt: skip
        with open(log, "wb") as out:
            self.daemon = subprocess.Popen(
                [str(c) for c in command],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                start_new_session=True,
            )
        deadline = time.monotonic() + 60
        while run(
            *self.prefix, self.client, *self.host, "info", check=False
        ).returncode != 0 or not self.text("info"):
            if self.daemon.poll() is not None or time.monotonic() > deadline:
                raise Failure(
                    "dockerd did not start; the end of what it said:\n"
                    f"{log.read_text(errors='replace')[-4000:]}"
                )
            time.sleep(0.2)
        self.pid = text(*AS_ROOT, "cat", pidfile)

    def _start_in(self):
        return []

    def _data(self):
        return CACHE / "engine"

    def stop(self):
        if self.daemon is not None and self.daemon.poll() is None:
            pid = self.pid or str(self.daemon.pid)
            run(*AS_ROOT, "kill", "-TERM", pid, check=False)
            try:
                self.daemon.wait(30)
            except subprocess.TimeoutExpired:
                run(*AS_ROOT, "kill", "-KILL", pid, check=False)
                self.daemon.wait(10)
        if self.scratch is not None:
            for line in Path("/proc/self/mounts").read_text().splitlines():
                if line.split()[1].startswith(f"{self.scratch}/"):
                    run(*AS_ROOT, "umount", line.split()[1], check=False)
            run(*AS_ROOT, "rm", "-rf", "--one-file-system", self.scratch, check=False)

    def __call__(self, *arguments, **options):
        return run(*self.prefix, self.client, *self.host, *arguments, **options)

    def text(self, *arguments, **options):
        return self(*arguments, **options).stdout.decode(errors="replace").strip()

    def build(self, *arguments):
        environment = f"DOCKER_BUILDKIT={int(self.buildkit)}"
        command = [*self.prefix, "env", environment, self.client, *self.host, "build", *arguments]
        return run(*command, *(["--progress=plain"] if self.buildkit else []))

    def tidy(self):
        """Removes leftovers of earlier runs from an engine that only this test uses."""
        self("container", "prune", "--force", check=False)
        self("image", "prune", "--force", check=False)
        if self.buildkit:
            self("builder", "prune", "--force", "--keep-storage", "6GB", check=False)


class Apart(Engine):
    """An engine as Docker sets it up, with bridges, published ports and its own DNS server, in a
    network of its own: it changes nothing on the machine, and every port is free. Its images are
    gone at the end."""

    NETWORK = []

    def open(self):
        self.own, self.client, self.buildkit = True, *self._client()
        self._start()
        # A command in the network of the engine, where its published ports are.
        self.inside = [*AS_ROOT, where("nsenter"), f"--net=/proc/{self.pid}/ns/net"]

    def _start_in(self):
        return ["unshare", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "dockerd"]

    def _data(self):
        return self.scratch / "data"

    def load(self, engine, tag, name, *lines):
        """Takes an image of another engine under a name, with more lines of a Dockerfile."""
        save = subprocess.Popen(
            [str(c) for c in (*engine.prefix, engine.client, *engine.host, "save", tag)],
            stdout=subprocess.PIPE,
        )
        self("load", stdin=save.stdout)
        save.stdout.close()
        if save.wait() != 0:
            raise Failure(f"the image {tag} could not be read")
        with tempfile.TemporaryDirectory(dir=self.scratch) as context:
            Path(context, "Dockerfile").write_text("\n".join([f"FROM {tag}", *lines, ""]))
            run(
                *self.prefix,
                "env",
                "DOCKER_BUILDKIT=0",
                self.client,
                *self.host,
                "build",
                "--tag",
                name,
                context,
            )
