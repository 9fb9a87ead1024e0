"""Firefox for Selenium without geckodriver, of which neither Debian nor a package registry has a
program that could be pinned: compiling it would take longer than all tests in Firefox. What it
does is translate; Selenium's commands are sent to Marionette, Firefox's own server, in its words.
"""

import json
import socket
import subprocess
import time

from selenium import webdriver
from selenium.common.exceptions import WebDriverException
from selenium.webdriver.remote.file_detector import UselessFileDetector

# Selenium's names of the commands that these tests use, and Marionette's.
COMMANDS = {
    "newSession": "WebDriver:NewSession",
    "setWindowRect": "WebDriver:SetWindowRect",
    "get": "WebDriver:Navigate",
    "w3cExecuteScript": "WebDriver:ExecuteScript",
    "findElement": "WebDriver:FindElement",
    "findElements": "WebDriver:FindElements",
    "clickElement": "WebDriver:ElementClick",
    "sendKeysToElement": "WebDriver:ElementSendKeys",
    "getElementText": "WebDriver:GetElementText",
    "actions": "WebDriver:PerformActions",
    "screenshot": "WebDriver:TakeScreenshot",
    "quit": "Marionette:Quit",
}
# Nothing but the tests' pages is opened or asked for; Firefox itself adds what is recommended for
# automation when Marionette starts.
PREFERENCES = {
    "marionette.port": 0,
    "app.normandy.enabled": False,
    "app.update.disabledForTesting": True,
    "browser.aboutwelcome.enabled": False,
    "browser.shell.checkDefaultBrowser": False,
    "browser.startup.homepage_override.mstone": "ignore",
    "browser.startup.page": 0,
    "datareporting.policy.dataSubmissionEnabled": False,
    "startup.homepage_welcome_url": "about:blank",
    "toolkit.telemetry.reportingpolicy.firstRun": False,
}


class Marionette:
    """What Selenium calls a command executor."""

    def __init__(self, process, port, patience):
        self.process = process
        self.patience = patience
        self.stream = socket.create_connection(("127.0.0.1", port), patience)
        self.reader = self.stream.makefile("rb")
        self.sent = 0
        greeting = self._read()
        assert greeting["marionetteProtocol"] == 3, greeting

    def _read(self):
        """A message, which stands behind its length and a colon."""
        length = b""
        while (digit := self.reader.read(1)) != b":":
            assert digit, "Firefox has closed the connection"
            length += digit
        return json.loads(self.reader.read(int(length)))

    def execute(self, command, params):
        """Sends a command; returns its response as Selenium expects it."""
        params = {key: value for key, value in (params or {}).items() if key != "sessionId"}
        if command == "newSession":
            params = {}
        elif command == "quit":
            params = {"flags": ["eForceQuit"]}
        self.sent += 1
        message = json.dumps([0, self.sent, COMMANDS[command], params]).encode()
        self.stream.sendall(b"%d:%s" % (len(message), message))
        _, answered, error, result = self._read()
        assert answered == self.sent, (answered, self.sent)
        if error:
            raise WebDriverException(f"{error['error']}: {error['message']}")
        is_wrapped = isinstance(result, dict) and result.keys() == {"value"}
        return {"value": result["value"] if is_wrapped else result}

    def close(self):
        self.stream.close()
        self.process.wait(self.patience)


def firefox(program, profile, preferences, log, env, patience):
    """A driver of a Firefox with a new profile, in a folder that does not exist yet."""
    profile.mkdir()
    lines = [
        f"user_pref({json.dumps(name)}, {json.dumps(value)});\n"
        for name, value in {**PREFERENCES, **preferences}.items()
    ]
    (profile / "user.js").write_text("".join(lines))
    command = [program, "--marionette", "--no-remote", "--new-instance", "--profile", profile]
    with open(log, "wb") as output:
        process = subprocess.Popen(
            command,
            env={**env, "MOZ_CRASHREPORTER_DISABLE": "1"},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
        )
    try:
        # Firefox writes the port that it listens at.
        written = profile / "MarionetteActivePort"
        give_up = time.monotonic() + patience
        while not (written.exists() and written.read_text().strip()):
            assert process.poll() is None, f"Firefox has ended: {log}"
            assert time.monotonic() < give_up, f"Firefox does not listen: {log}"
            time.sleep(0.05)
        # Files are on this machine: there is nothing to upload before they are chosen.
        return webdriver.Remote(
            Marionette(process, int(written.read_text()), patience),
            file_detector=UselessFileDetector(),
            options=webdriver.FirefoxOptions(),
        )
    except BaseException:
        process.kill()
        process.wait()
        raise
