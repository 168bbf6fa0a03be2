// The page "Live" in a real browser, with real cameras.

import type { Browser, Page } from "playwright-core";
import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, test } from "vitest";
import { at, difference, launch, look, noBrowser, share } from "./browser.ts";
import { Camera, frame, half, noCamera } from "./camera.ts";
import { Stereod } from "./stereod.ts";

const why = noBrowser || noCamera;
if (why) {
  console.warn(`skipped: the console's tests with live cameras, ${why}`);
}

const canvas = (part: string) => `#live [data-part=${part}] .stage canvas`;
const PATIENCE = { timeout: 30_000 };

describe.skipIf(why !== "")("Live", () => {
  let server: Stereod;
  let browser: Browser;
  let page: Page;
  let cameras: Camera[];
  let complaints: string[];

  const text = (selector: string) => page.locator(selector).textContent();
  /** In budget and late together. */
  const answered = async () => {
    const counts = await page.locator("#counts tr:has-text('answered') td:last-child").allTextContents();
    return counts.reduce((sum, count) => sum + Number(count.replace(/\s/g, "")), 0);
  };
  const front = async () => {
    cameras.push(await Camera.start(await server.zenohEndpoint(), "front", [frame(0), frame(0.9)]));
  };

  beforeAll(async () => {
    [server, browser] = await Promise.all([Stereod.start(), launch()]);
  });

  afterAll(async () => {
    await browser?.close();
    await server?.kill();
  });

  beforeEach(async () => {
    cameras = [];
    page = await browser.newPage({ viewport: { width: 1280, height: 900 }, reducedMotion: "reduce" });
    complaints = [];
    page.on("pageerror", (error) => complaints.push(error.message));
  });

  afterEach(async () => {
    await page.close();
    await Promise.all(cameras.map((camera) => camera.stop()));
    expect(complaints).toEqual([]);
  });

  test("without a camera, the page says how one gets there", async () => {
    await page.goto(`${server.url}/#/live`);
    await expect.poll(() => text("#cameras-hint"), PATIENCE).toMatch(/puts frames to stereo\/v1\/frames\/NAME/);
    await expect.poll(() => text("#fleet"), PATIENCE).toMatch(/Serversstereod/);
  });

  test("a camera is followed frame by frame", async () => {
    await page.goto(`${server.url}/#/live`);
    await front();
    await expect.poll(() => text("#cameras"), PATIENCE).toMatch(/^front\d+ Hz$/);
    await expect.poll(() => page.locator("#live [data-part=mesh]").getAttribute("data-state"), PATIENCE).toBe("full");

    const left = await look(page, canvas("left"));
    const [red, , blue] = at(left, 0.53, 0.45);
    expect(red, "the orange ball").toBeGreaterThan(2 * blue);
    let disparity = await look(page, canvas("disparity"));
    // Every other frame leaves out what isn't certain, here perhaps.
    const warmth = async () => {
      disparity = await look(page, canvas("disparity"));
      const [nearRed, , nearBlue] = at(disparity, 0.43, 0.88);
      return nearRed / nearBlue;
    };
    await expect.poll(warmth, { ...PATIENCE, message: "the ball in front is warm" }).toBeGreaterThan(2);
    const mesh = await look(page, canvas("mesh"));
    expect(share(mesh, (r, g, b) => r > 140 && g > 60 && g < 0.85 * r && b < 0.5 * r)).toBeGreaterThan(0.003);
    expect(await text("#live [data-part=disparity] .legend")).toMatch(/Depth from .*\sm, far to near/);

    await expect.poll(async () => difference(disparity, await look(page, canvas("disparity"))), PATIENCE).toBeGreaterThan(0.02);

    const before = await answered();
    await expect.poll(answered, PATIENCE).toBeGreaterThan(before);
    const bars = () => page.locator("#frames rect.whole, #frames rect.fewer").count();
    await expect.poll(bars, PATIENCE).toBeGreaterThan(5);
    expect(await text("#frames .hint")).toMatch(/The last \d+ frames: .* ms in the middle, \d+ in budget, \d+ dropped/);
  });

  test("frames that are dropped are counted under their reason", async () => {
    cameras.push(await Camera.start(await server.zenohEndpoint(), "broken", [half()]));
    await page.goto(`${server.url}/#/live/broken`);
    await expect.poll(() => text("#counts"), PATIENCE).toMatch(/dropped: invalid[1-9]/);
    await expect.poll(() => page.locator("#frames rect.dropped").count(), PATIENCE).toBeGreaterThan(0);
    await expect.poll(() => text("#live-problem"), PATIENCE).toMatch(/broken/);
  });

  test("the page follows the camera again when server and camera are back", async () => {
    await front();
    await page.goto(`${server.url}/#/live/front`);
    const full = () => page.locator("#live [data-part=mesh]").getAttribute("data-state");
    await expect.poll(full, PATIENCE).toBe("full");
    await server.kill();
    await expect.poll(() => text("#banner"), PATIENCE).toMatch(/doesn't answer: start it again/);
    await cameras.pop()?.stop();
    server = await Stereod.start(server.address);
    await expect.poll(() => page.locator("#banner").isHidden(), PATIENCE).toBe(true);
    await front();
    await expect.poll(() => page.locator("#counts").textContent(), PATIENCE).toMatch(/answered/);
    const before = await answered();
    await expect.poll(answered, PATIENCE).toBeGreaterThan(before);
    const bars = await page.locator("#frames rect").count();
    await expect.poll(() => page.locator("#frames rect").count(), PATIENCE).toBeGreaterThan(bars);
  });

  test("a server without Zenoh says so", async () => {
    const deaf = await Stereod.start("127.0.0.1:0", ["--no-zenoh"]);
    try {
      await page.goto(`${deaf.url}/#/live`);
      await expect.poll(() => text("#cameras-hint"), PATIENCE).toMatch(/without --no-zenoh/);
    } finally {
      await deaf.kill();
    }
  });
});
