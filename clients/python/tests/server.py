"""The real server as a child process on a port of its own."""

from __future__ import annotations

import json
import subprocess
import urllib.request
from typing import IO

from stereo_client import Client


class Server:
    def __init__(self, process: subprocess.Popen[str], output: IO[str], url: str) -> None:
        self.process = process
        self.output = output
        self.url = url

    @classmethod
    def start(cls, program: str, *args: str) -> Server:
        """Start it on a free port and wait until it takes frames."""
        process = subprocess.Popen(
            [program, "serve", "--http", "127.0.0.1:0", "--log", "error", *args], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        for line in process.stdout:
            if "listening on " in line:
                server = cls(process, process.stdout, line.split("listening on ")[1].strip())
                with Client(server.url) as client:
                    client.wait_ready()
                return server
        raise AssertionError(f"stereod ended before it listened: {process.wait()}")

    def zenoh(self) -> str:
        """Where it listens for Zenoh, as an address of the client."""
        with urllib.request.urlopen(f"{self.url}/v1/streams") as answer:
            return "zenoh://" + json.load(answer)["zenoh"]["locators"][0]

    def stop(self) -> int:
        """Ask it to stop, as a service manager does, and wait until it has."""
        self.process.terminate()
        code = self.process.wait()
        self.output.close()
        return code

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.output.close()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.stop()
        self.output.close()
