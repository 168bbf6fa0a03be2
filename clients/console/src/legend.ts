// The scale under a map: a strip of its colours and what they stand for.

import type { Palette } from "./color.ts";
import { make } from "./dom.ts";
import { short } from "./format.ts";
import type { Calibration } from "./gen/stereo/v1/calibration_pb.ts";
import { depthM, type Range } from "./maps.ts";

/** Places along the strip that get a number. */
const TICKS = 5;

/** Fills `element` with a strip and `labels` at even distances below it. */
function legend(element: HTMLElement, palette: Palette, labels: string[], description: string): void {
  const strip = make("canvas", { width: "256", height: "1", "aria-hidden": "true" });
  strip.getContext("2d")?.putImageData(new ImageData(palette.slice() as Uint8ClampedArray<ArrayBuffer>, 256, 1), 0, 0);
  const ticks = make("div", { class: "ticks", "aria-hidden": "true" }, ...labels.map((label) => make("span", {}, label)));
  element.replaceChildren(strip, ticks, make("span", { class: "unseen" }, description));
}

/** The scale of disparities: in metres when calibrated, else in pixels. */
export function disparityLegend(element: HTMLElement, palette: Palette, range: Range, calibration?: Calibration): void {
  const values = Array.from({ length: TICKS }, (_, i) => range.from + ((range.to - range.from) * i) / (TICKS - 1));
  const shown = calibration ? values.map((px) => depthM(px, calibration)) : values;
  const unit = calibration ? "m" : "px";
  const labels = shown.map((value, i) => (i === TICKS - 1 ? `${short(value)}\u00a0${unit}` : short(value)));
  const what = calibration ? "Depth" : "Disparity";
  legend(element, palette, labels, `${what} from ${labels[0]} to ${labels[TICKS - 1]}, far to near.`);
}

/** The scale of confidences. */
export function confidenceLegend(element: HTMLElement, palette: Palette): void {
  legend(element, palette, ["0", "25", "50", "75", "100\u00a0%"], "Confidence from 0 to 100 %.");
}
