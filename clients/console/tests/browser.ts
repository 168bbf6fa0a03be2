// A headless Chromium, and what can be seen in it.

import { existsSync } from "node:fs";
import { type Browser, chromium, type Page } from "playwright-core";

const executablePath = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find(
  (path) => path !== undefined && existsSync(path),
);

/** Why there is no browser; empty if there is one. */
export const noBrowser = executablePath
  ? ""
  : "no Chromium is installed (Debian: apt-get install chromium; elsewhere, name it with CHROMIUM=/path)";

/** Starts one that renders WebGL without a graphics card. */
export function launch(): Promise<Browser> {
  const quiet = ["quic", "background-networking", "component-update", "sync"].map((name) => `--disable-${name}`);
  const graphics = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
  return chromium.launch({
    ...(executablePath ? { executablePath } : {}),
    args: ["--no-sandbox", "--no-first-run", ...graphics, ...quiet],
  });
}

/** Pixels as they are on the screen. */
export interface Picture {
  width: number;
  height: number;
  /** Red, green, blue and alpha of each. */
  data: Uint8Array;
}

/** What an element looks like. */
export async function look(page: Page, selector: string): Promise<Picture> {
  const file = await page.locator(selector).screenshot({ animations: "disabled" });
  const picture = await page.evaluate(async (base64) => {
    const bytes = Uint8Array.from(atob(base64), (char) => char.charCodeAt(0));
    const bitmap = await createImageBitmap(new Blob([bytes]));
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    const context = canvas.getContext("2d");
    context?.drawImage(bitmap, 0, 0);
    const data = context?.getImageData(0, 0, bitmap.width, bitmap.height).data ?? [];
    // Text goes over to the test much faster than numbers do.
    const pieces: string[] = [];
    for (let i = 0; i < data.length; i += 0x8000) {
      pieces.push(String.fromCharCode(...data.slice(i, i + 0x8000)));
    }
    return { width: bitmap.width, height: bitmap.height, data: btoa(pieces.join("")) };
  }, file.toString("base64"));
  return { ...picture, data: Buffer.from(picture.data, "base64") };
}

/** Red, green and blue at a place given as shares of the width and the height. */
export function at({ width, height, data }: Picture, x: number, y: number): [number, number, number] {
  const i = 4 * (Math.floor(y * height) * width + Math.floor(x * width));
  return [data[i] ?? 0, data[i + 1] ?? 0, data[i + 2] ?? 0];
}

/** The share of the pixels for which `test` holds. */
export function share(picture: Picture, test: (red: number, green: number, blue: number) => boolean): number {
  const pixels = picture.data.length / 4;
  let count = 0;
  for (let i = 0; i < picture.data.length; i += 4) {
    count += Number(test(picture.data[i] ?? 0, picture.data[i + 1] ?? 0, picture.data[i + 2] ?? 0));
  }
  return count / pixels;
}

/** The share of the pixels in which two pictures of one size differ visibly. */
export function difference(one: Picture, two: Picture): number {
  let count = 0;
  for (let i = 0; i < one.data.length; i += 4) {
    const parts = [0, 1, 2].map((k) => Math.abs((one.data[i + k] ?? 0) - (two.data[i + k] ?? 0)));
    count += Number(Math.max(...parts) > 24);
  }
  return count / (one.data.length / 4);
}
