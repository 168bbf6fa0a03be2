// Renders the sample pair into `public/sample`: `npm run sample`. Needs Chromium.

import { mkdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { chromium } from "playwright-core";
import { createServer } from "vite";

const folder = join(import.meta.dirname, "../public/sample");
const server = await createServer({ configFile: false, root: import.meta.dirname, logLevel: "error", server: { port: 0 } });
await server.listen();
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
try {
  const page = await browser.newPage();
  page.on("console", (message) => console.error(message.text()));
  page.on("pageerror", (error) => console.error(error));
  await page.goto(`${server.resolvedUrls?.local[0]}scene.html`);
  await page.waitForFunction(() => "sample" in window);
  const { views, calibration } = await page.evaluate(() => ({
    views: window.sample.render(),
    calibration: window.sample.calibration,
  }));
  mkdirSync(folder, { recursive: true });
  ["left", "right"].forEach((side, i) => {
    writeFileSync(join(folder, `${side}.jpg`), Buffer.from(views[i].split(",")[1], "base64"));
  });
  writeFileSync(join(folder, "calibration.json"), `${JSON.stringify(calibration)}\n`);
} finally {
  await browser.close();
  await server.close();
}
