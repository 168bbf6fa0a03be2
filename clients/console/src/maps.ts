// Maps of a result: read from its bytes, painted, and read off again.

import { type Palette, place } from "./color.ts";
import type { Calibration } from "./gen/stereo/v1/calibration_pb.ts";
import type { Disparity } from "./gen/stereo/v1/disparity_pb.ts";

/** Disparities are in 1/256 px, 0 = none. */
export const FIXED_PER_PX = 256;
/** Share of the disparities beyond each end of the scale, so that a few wrong ones don't take the contrast. */
const TAIL = 0.02;

/** The maps of one frame. */
export interface Maps {
  width: number;
  height: number;
  /** In 1/256 px, 0 = none; row by row. */
  disparity: Uint16Array;
  /** 0 to 254; row by row. */
  confidence: Uint8Array;
  calibration: Calibration | undefined;
}

/** The ends of a scale, in px. */
export interface Range {
  from: number;
  to: number;
}

/** Reads 16-bit maps, which is what the page asks for. */
export function readMaps({ width, height, step, data, confidence, calibration }: Disparity): Maps {
  const disparity = new Uint16Array(width * height);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0, at = y * step; x < width; x++, at += 2) {
      disparity[i++] = view.getUint16(at, true);
    }
  }
  return { width, height, disparity, confidence, calibration };
}

/** The scale of a map: from its 2nd to its 98th percentile. */
export function rangeOf(disparity: Uint16Array): Range {
  const histogram = new Uint32Array(0x10000);
  for (const fixed of disparity) {
    histogram[fixed] = (histogram[fixed] ?? 0) + 1;
  }
  const valid = disparity.length - (histogram[0] ?? 0);
  const rank = (wanted: number) => {
    let seen = 0;
    for (let fixed = 1; fixed < histogram.length; fixed++) {
      seen += histogram[fixed] ?? 0;
      if (seen > wanted) {
        return fixed / FIXED_PER_PX;
      }
    }
    return 0;
  };
  return { from: rank(valid * TAIL), to: rank(Math.max(valid * (1 - TAIL) - 1, 0)) };
}

/** Paints disparities: near is warm, far is cold, none is left empty. */
export function paintDisparity(canvas: HTMLCanvasElement, maps: Maps, range: Range, palette: Palette): void {
  const table = new Uint32Array(0x10000);
  const colors = words(palette);
  for (let fixed = 1; fixed < table.length; fixed++) {
    table[fixed] = colors[place(fixed / FIXED_PER_PX, range.from, range.to)] ?? 0;
  }
  paint(canvas, maps, maps.disparity, table);
}

/** Paints confidences where there is a disparity. */
export function paintConfidence(canvas: HTMLCanvasElement, maps: Maps, palette: Palette): void {
  const colors = words(palette);
  const table = new Uint32Array(256);
  for (let value = 1; value < 256; value++) {
    table[value] = colors[place(value, 0, 254)] ?? 0;
  }
  paint(canvas, maps, maps.confidence, table);
}

function paint(canvas: HTMLCanvasElement, maps: Maps, values: Uint16Array | Uint8Array, table: Uint32Array): void {
  canvas.width = maps.width;
  canvas.height = maps.height;
  const image = new ImageData(maps.width, maps.height);
  const pixels = new Uint32Array(image.data.buffer);
  for (let i = 0; i < pixels.length; i++) {
    pixels[i] = table[values[i] ?? 0] ?? 0;
  }
  canvas.getContext("2d")?.putImageData(image, 0, 0);
}

/** Four bytes of a colour as one word, in the order of this machine. */
function words(palette: Palette): Uint32Array {
  return new Uint32Array(palette.slice().buffer);
}

/** Depth in metres at a disparity in px. */
export function depthM(disparityPx: number, { focalPx, baselineM, doffsPx }: Calibration): number {
  return (focalPx * baselineM) / (disparityPx + doffsPx);
}
