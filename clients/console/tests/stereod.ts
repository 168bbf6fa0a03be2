// The real server as a child process, on a port of its own.

import { type ChildProcess, spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { join } from "node:path";
import { createInterface } from "node:readline";

/** Cargo's target folder. */
export const target = process.env.CARGO_TARGET_DIR ?? join(import.meta.dirname, "../../../target");
/** The server's program. */
export const binary = join(target, "release/stereod");

/** A running server. */
export class Stereod {
  private constructor(
    readonly url: string,
    private readonly child: ChildProcess,
  ) {}

  /** Starts one on `address` and waits until it listens. */
  static async start(address = "127.0.0.1:0", args: string[] = []): Promise<Stereod> {
    if (!existsSync(binary)) {
      throw new Error(`there is no ${binary}: build it with \`cargo build --release -p stereod\``);
    }
    const child = spawn(binary, ["serve", "--http", address, "--log", "error", ...args], { stdio: ["ignore", "pipe", "inherit"] });
    for await (const line of createInterface({ input: child.stdout })) {
      const url = /listening on (http\S+)/.exec(line)?.[1];
      if (url) {
        return new Stereod(url, child);
      }
    }
    throw new Error(`stereod ended before it listened: ${child.exitCode}`);
  }

  /** Where its cameras send their frames. */
  async zenohEndpoint(): Promise<string> {
    for (;;) {
      // For everybody, also where tokens are asked for.
      const { zenoh } = await (await fetch(`${this.url}/readyz`)).json();
      if (zenoh?.locators?.[0]) {
        return zenoh.locators[0];
      }
      await new Promise((resolve) => setTimeout(resolve, 50));
    }
  }

  /** Where it listens, to be started there again. */
  get address(): string {
    return new URL(this.url).host;
  }

  /** Ends it as a crash does, and waits until it is gone. */
  async kill(): Promise<void> {
    const gone = new Promise((resolve) => this.child.once("exit", resolve));
    this.child.kill("SIGKILL");
    await gone;
  }
}
