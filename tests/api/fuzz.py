"""Sends every route what its description allows and what it doesn't, and checks that the answers are as described: `make test-api`."""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# What a schema can't say: that the bytes of a picture are one. So good data may well be refused.
UNCHECKED = "positive_data_acceptance"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stereod", default=str(ROOT / "target/release/stereod"), help="the server's program")
    parser.add_argument("--examples", type=int, default=60, help="requests a route, at most, of each kind")
    parser.add_argument("--seed", type=int, default=1, help="other requests for another number")
    args = parser.parse_args()
    if not Path(args.stereod).is_file():
        sys.exit(f"there is no {args.stereod}: build it with `cargo test --release --workspace --no-run`")
    fuzzer = shutil.which("schemathesis", path=Path(sys.executable).parent)
    if fuzzer is None:
        sys.exit("schemathesis is not installed beside this Python: run `make test-api`")
    printed = subprocess.run([args.stereod, "token", "fuzzer"], check=True, capture_output=True, text=True).stdout
    token = next(line for line in printed.splitlines() if line.startswith("stereod_"))
    config = ROOT / "target/api.toml"
    config.write_text(printed[printed.index("[clients.") :])
    server = subprocess.Popen(
        [args.stereod, "serve", "--http", "127.0.0.1:0", "--log", "error", "--config", str(config)],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        url = next(line.split("listening on ")[1].strip() for line in server.stdout if "listening on " in line)
        fuzzed = subprocess.run(
            [
                *(fuzzer, "run", f"{url}/openapi.json", "--wait-for-schema=60", "--phases=examples,coverage,fuzzing"),
                *("--header", f"Authorization: Bearer {token}"),
                *(f"--max-examples={args.examples}", f"--seed={args.seed}", "--request-timeout=10", "--workers=1"),
                *(f"--exclude-checks={UNCHECKED}", "--generation-database=none", "--no-color"),
            ],
            check=False,
            # Where it leaves its notes.
            cwd=ROOT / "target",
            env=os.environ | {"SCHEMATHESIS_HOOKS": "hooks", "PYTHONPATH": str(Path(__file__).parent)},
        )
        if server.poll() is not None:
            sys.exit(f"the server ended with {server.returncode}")
    finally:
        server.terminate()
        ended = server.wait()
    if ended != 0:
        sys.exit(f"the server ended with {ended} when it was asked to stop")
    return fuzzed.returncode


if __name__ == "__main__":
    sys.exit(main())
