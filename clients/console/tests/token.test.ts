// A server that lets in nobody without a token.

import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import type { Browser, Page } from "playwright-core";
import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, test } from "vitest";
import { launch, noBrowser } from "./browser.ts";
import { Camera, frame, noCamera } from "./camera.ts";
import { binary, Stereod } from "./stereod.ts";

const PATIENCE = { timeout: 30_000 };

describe.skipIf(noBrowser !== "")("A token", () => {
  let folder: string;
  let token: string;
  let server: Stereod;
  let browser: Browser;
  let page: Page;
  let complaints: string[];

  const door = () => page.locator("#door");
  const enter = async (text: string) => {
    await page.locator("#token").fill(text);
    await page.keyboard.press("Enter");
  };

  /** The sample has been matched, in a budget that a busy machine can meet. */
  const isMatched = async () => {
    await expect.poll(() => page.locator("#server").textContent(), PATIENCE).toMatch(/worker/);
    await page.locator("#budget").press("End");
    await expect.poll(() => page.locator("#said").textContent(), PATIENCE).toMatch(/3 of 3 rungs/);
  };

  beforeAll(async () => {
    folder = mkdtempSync(join(tmpdir(), "stereod-token-"));
    const made = execFileSync(binary, ["token", "lab"], { encoding: "utf8" });
    token = /^stereod_\w+$/m.exec(made)?.[0] ?? "";
    const config = join(folder, "stereod.toml");
    writeFileSync(config, made.slice(made.indexOf("[clients.lab]")));
    [server, browser] = await Promise.all([Stereod.start("127.0.0.1:0", ["--config", config]), launch()]);
  });

  afterAll(async () => {
    await browser?.close();
    await server?.kill();
    rmSync(folder, { recursive: true });
  });

  beforeEach(async () => {
    page = await browser.newPage({ viewport: { width: 1280, height: 900 }, reducedMotion: "reduce" });
    complaints = [];
    page.on("pageerror", (error) => complaints.push(error.message));
    await page.goto(server.url);
    await expect.poll(() => door().isVisible(), PATIENCE).toBe(true);
  });

  afterEach(async () => {
    await page.close();
    expect(complaints).toEqual([]);
  });

  test("is asked for, by a dialog that has the focus", async () => {
    expect(await page.locator("#door-title").textContent()).toBe("This server asks for a token");
    expect(await page.evaluate(() => document.activeElement?.id)).toBe("token");
    expect(await page.locator("#token").getAttribute("type")).toBe("password");
    expect(await page.locator("#server").textContent()).toContain("token needed");
  });

  test("that the server doesn't know is refused by its own sentence, and another one can be tried", async () => {
    await enter("stereod_wrong");
    await expect.poll(() => page.locator("#door-problem").textContent(), PATIENCE).toMatch(/token/);
    expect(await door().isVisible()).toBe(true);
    await enter(token);
    await isMatched();
    expect(await door().isVisible()).toBe(false);
    expect(await page.locator("#enter").isHidden()).toBe(true);
  });

  test("can wait: the page says what is missing, and a button asks again", async () => {
    await page.keyboard.press("Escape");
    await expect.poll(() => door().isVisible(), PATIENCE).toBe(false);
    expect(await page.locator("#banner").textContent()).toMatch(/token/);
    await page.locator("#enter").click();
    await enter(token);
    await expect.poll(() => page.locator("#banner").isHidden(), PATIENCE).toBe(true);
  });

  test("is kept for the tab, and is in no snippet", async () => {
    await enter(token);
    await isMatched();
    await page.reload();
    await isMatched();
    expect(await page.locator("#curl pre").textContent()).toContain('"Authorization: Bearer $STEREO_TOKEN"');
    expect(await page.locator("#python pre").textContent()).toContain('token=environ["STEREO_TOKEN"]');
    expect(await page.content()).not.toContain(token);
  });

  test.skipIf(noCamera !== "")("shows the cameras, live", async () => {
    await enter(token);
    const camera = await Camera.start(await server.zenohEndpoint(), "front", [frame(0)]);
    try {
      await page.goto(`${server.url}/#/live/front`);
      await expect.poll(() => page.locator("#live [data-part=mesh]").getAttribute("data-state"), PATIENCE).toBe("full");
      await expect.poll(() => page.locator("#frames rect").count(), PATIENCE).toBeGreaterThan(3);
    } finally {
      await camera.stop();
    }
  });
});
