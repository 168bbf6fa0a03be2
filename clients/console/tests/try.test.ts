// The page "Try it" in a real browser, on a real server.

import { execFileSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import type { Browser, Page } from "playwright-core";
import { afterAll, afterEach, beforeAll, beforeEach, describe, expect, test } from "vitest";
import { at, difference, launch, look, noBrowser, share } from "./browser.ts";
import { Stereod, target } from "./stereod.ts";

if (noBrowser) {
  console.warn(`skipped: the console's browser tests, ${noBrowser}`);
}

const sample = join(import.meta.dirname, "../public/sample");
const file = (side: string) => ({ name: `my_${side}.jpg`, mimeType: "image/jpeg", buffer: readFileSync(join(sample, `${side}.jpg`)) });
/** A Python that has the client. */
const venv = join(target, "venv-python/bin/python");
const canvas = (part: string) => `#try [data-part=${part}] .stage canvas`;

describe.skipIf(noBrowser !== "")("Try it", () => {
  let server: Stereod;
  let browser: Browser;
  let page: Page;
  /** What the page has complained about: refused responses are told to the user, anything else is a fault. */
  let complaints: string[];

  const said = () => page.locator("#said").textContent();
  const problem = () => page.locator("#problem").textContent();
  const toHaveSaid = (text: RegExp) => expect.poll(said, { timeout: 20_000 }).toMatch(text);
  const toHaveProblem = (text: RegExp) => expect.poll(problem, { timeout: 20_000 }).toMatch(text);
  const choose = (side: string, files: { name: string; mimeType: string; buffer: Buffer }) =>
    page.locator(`[data-side=${side}] input`).setInputFiles(files);
  /** A budget that is long enough for every rung on a busy machine. */
  const takeYourTime = () => page.locator("#budget").press("End");

  beforeAll(async () => {
    [server, browser] = await Promise.all([Stereod.start(), launch()]);
  });

  afterAll(async () => {
    await browser?.close();
    await server?.kill();
  });

  beforeEach(async () => {
    page = await browser.newPage({ viewport: { width: 1280, height: 900 }, reducedMotion: "reduce" });
    complaints = [];
    page.on("pageerror", (error) => complaints.push(error.message));
    page.on("console", (message) => {
      if (message.type() === "error" && !/Failed to load resource/.test(message.text())) {
        complaints.push(message.text());
      }
    });
    await page.goto(server.url);
    // The sample comes by itself, in a budget that a busy machine may not meet.
    await takeYourTime();
    await toHaveSaid(/of 10000 ms, 3 of 3 rungs/);
  });

  afterEach(async () => {
    await page.close();
    expect(complaints).toEqual([]);
  });

  test("an uploaded pair becomes a disparity map, confidences and a textured mesh", async () => {
    await choose("left", file("left"));
    await toHaveSaid(/choose the right image/);
    expect(await page.locator("#try [data-part=disparity]").getAttribute("data-state")).toBe("empty");
    await choose("right", file("right"));
    await toHaveSaid(/of 10000 ms, 3 of 3 rungs/);

    const disparity = await look(page, canvas("disparity"));
    const [nearRed, , nearBlue] = at(disparity, 0.43, 0.88);
    const [farRed, , farBlue] = at(disparity, 0.4, 0.15);
    expect(nearRed, "the ball in front is warm").toBeGreaterThan(2 * nearBlue);
    expect(farBlue, "the wall is cold").toBeGreaterThan(1.5 * farRed);
    expect(await page.locator("#try [data-part=disparity] .legend").textContent()).toMatch(/\d\spx/);

    const confidence = await look(page, canvas("confidence"));
    expect(share(confidence, (r, g, b) => r > 180 && g > 160 && b < 120), "most is certain").toBeGreaterThan(0.4);

    const mesh = await look(page, canvas("mesh"));
    expect(share(mesh, (r, g, b) => r > 140 && g > 60 && g < 0.85 * r && b < 0.5 * r), "the orange ball").toBeGreaterThan(0.005);
    expect(share(mesh, (r, g, b) => g > r && b > r && r > 20 && r < 200), "the gray-blue wall").toBeGreaterThan(0.1);
  });

  test("depth is in metres as soon as there is a calibration", async () => {
    expect(await page.locator("#try [data-part=disparity] .legend").textContent()).toMatch(/Depth from 4\.\d+ to 1\.\d+\s*m/);
    await page.locator("#calibration summary").click();
    await page.locator("#baseline").fill("0.32");
    await page.locator("#baseline").press("Tab");
    await expect
      .poll(() => page.locator("#try [data-part=disparity] .legend").textContent(), { timeout: 20_000 })
      .toMatch(/Depth from 8\.\d+ to 2\.\d+\s*m/);
  });

  test("the mesh turns with the keys and comes back", async () => {
    await page.locator(canvas("mesh")).focus();
    const first = await look(page, canvas("mesh"));
    for (let i = 0; i < 5; i++) {
      await page.keyboard.press("ArrowRight");
    }
    await expect.poll(async () => difference(first, await look(page, canvas("mesh")))).toBeGreaterThan(0.05);
    await page.keyboard.press("0");
    await expect.poll(async () => difference(first, await look(page, canvas("mesh")))).toBeLessThan(0.005);
  });

  test("the budget slider decides what can be done", async () => {
    // The server has matched such pairs by now, and knows that they take more than two milliseconds.
    await page.locator("#budget").press("Home");
    await toHaveProblem(/^(A|The) budget of 2 ms .*now it would take at least \d+(\.\d+)? ms\.$/);
    await takeYourTime();
    await toHaveSaid(/of 10000 ms, 3 of 3 rungs/);
    expect(await problem()).toBe("");
  });

  test("another preset is another map", async () => {
    const sharp = await look(page, canvas("disparity"));
    await page.locator("#preset").selectOption("paper");
    await toHaveSaid(/of 10000 ms, [1-5] of 5 rungs/);
    await expect.poll(async () => difference(sharp, await look(page, canvas("disparity")))).toBeGreaterThan(0.02);
  });

  test("quality over the budget is plotted, and told in numbers", async () => {
    await page.locator("#measure").click();
    await toHaveSaid(/11 budgets tried/);
    const rows = await page.locator("#quality tbody tr").allTextContents();
    expect(rows).toHaveLength(11);
    expect(rows.at(-1)).toMatch(/^500 ms.*3 \(full\)\d+ %$/);
    expect(await page.locator("#quality circle.rung").count()).toBeGreaterThan(0);
  });

  test("what was done can be copied as commands, and they work", async () => {
    await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
    const copied = async (which: string) => {
      await page.locator(`${which} button`).click();
      return page.evaluate(() => navigator.clipboard.readText());
    };
    const folder = mkdtempSync(join(tmpdir(), "stereod-console-"));
    try {
      const picture = join(folder, "disparity_color.png");
      execFileSync("sh", ["-c", await copied("#curl")], { cwd: folder });
      const [left, made] = [readFileSync(join(folder, "left.jpg")), readFileSync(picture)];
      expect(left).toEqual(file("left").buffer);
      expect(made.subarray(1, 4).toString()).toBe("PNG");

      const script = await copied("#python");
      expect(script).toContain(`with Client("${server.url}") as client:`);
      if (existsSync(venv)) {
        rmSync(picture);
        execFileSync(venv, ["-c", script], { cwd: folder });
        expect(readFileSync(picture).subarray(1, 4).toString()).toBe("PNG");
      } else {
        console.warn(`skipped: running the Python that was copied, there is no ${venv} (make test-python)`);
      }
    } finally {
      rmSync(folder, { recursive: true });
    }
  });

  test("a wrong file is refused in one sentence, and the pair stays", async () => {
    await choose("left", { name: "notes.png", mimeType: "image/png", buffer: Buffer.from("not an image") });
    await toHaveProblem(/^notes\.png is neither a PNG nor a JPEG file: choose an image of one of these kinds\.$/);
    expect(await page.locator("[data-side=left] .name").textContent()).toBe("left.jpg");
    await choose("left", { name: "half.jpg", mimeType: "image/jpeg", buffer: file("left").buffer.subarray(0, 200) });
    await toHaveProblem(/^half\.jpg can't be read.*choose another image\.$/);
  });

  test("images of different sizes are refused by the server's own sentence", async () => {
    const small = await page.evaluate(() => {
      const made = document.createElement("canvas");
      made.width = 320;
      made.height = 200;
      return made.toDataURL("image/png").split(",")[1] ?? "";
    });
    await choose("left", file("left"));
    await choose("right", { name: "small.png", mimeType: "image/png", buffer: Buffer.from(small, "base64") });
    await toHaveProblem(/640.*480.*320.*200|320.*200.*640.*480/);
    await choose("right", file("right"));
    await toHaveSaid(/3 of 3 rungs/);
    expect(await problem()).toBe("");
  });

  test("the page says that the server is gone, and goes on when it is back", async () => {
    await server.kill();
    const banner = page.locator("#banner");
    await expect.poll(() => banner.textContent(), { timeout: 20_000 }).toMatch(/doesn't answer: start it again/);
    await page.locator("#match").click();
    await toHaveProblem(/doesn't answer: start it again/);
    server = await Stereod.start(server.address);
    await expect.poll(() => banner.isHidden(), { timeout: 20_000 }).toBe(true);
    await toHaveSaid(/of 10000 ms, 3 of 3 rungs/);
    expect(await problem()).toBe("");
  });

  test("everything can be reached and is named for a screen reader", async () => {
    const unnamed = await page.evaluate(() =>
      [...document.querySelectorAll<HTMLElement>("button, select, input, a, canvas[tabindex]")]
        .filter((element) => element.offsetParent !== null)
        .filter((element) => {
          const labels = (element as HTMLInputElement).labels;
          const name = element.getAttribute("aria-label") ?? (labels?.length ? labels[0]?.textContent : element.textContent);
          return !name?.trim();
        })
        .map((element) => element.outerHTML),
    );
    expect(unnamed).toEqual([]);
    const reached = new Set<string>();
    await page.locator(".skip").focus();
    for (let i = 0; i < 30; i++) {
      reached.add(await page.evaluate(() => document.activeElement?.id || document.activeElement?.tagName || ""));
      await page.keyboard.press("Tab");
    }
    for (const id of ["sample", "budget", "preset", "density", "confidence", "match", "measure", "CANVAS"]) {
      expect(reached, "reached with the Tab key").toContain(id);
    }
  });

  test("the page fits into a picture", async () => {
    await page.setViewportSize({ width: 1360, height: 1010 });
    await page.mouse.move(0, 0);
    await page.locator("#budget").blur();
    const png = await page.screenshot();
    const webp = await page.evaluate(async (base64) => {
      const bytes = Uint8Array.from(atob(base64), (char) => char.charCodeAt(0));
      const bitmap = await createImageBitmap(new Blob([bytes]));
      const drawn = document.createElement("canvas");
      [drawn.width, drawn.height] = [bitmap.width, bitmap.height];
      drawn.getContext("2d")?.drawImage(bitmap, 0, 0);
      return drawn.toDataURL("image/webp", 0.86).split(",")[1] ?? "";
    }, png.toString("base64"));
    const picture = Buffer.from(webp, "base64");
    expect(picture.length).toBeGreaterThan(20_000);
    expect(picture.length).toBeLessThan(200_000);
    // `npm run screenshot` makes the README's.
    if (process.env.SCREENSHOT) {
      writeFileSync(process.env.SCREENSHOT, picture);
    }
  });

  test.each([
    ["a tablet", 820],
    ["a phone", 390],
  ])("nothing sticks out on %s", async (_, width) => {
    await page.setViewportSize({ width, height: 1100 });
    expect(await page.evaluate(() => document.documentElement.scrollWidth)).toBeLessThanOrEqual(width);
  });
});
