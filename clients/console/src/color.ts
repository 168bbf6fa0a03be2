// Perceptual colour maps as tables: turbo (Mikhailov 2019), viridis and cividis.

import { interpolateCividis, interpolateTurbo, interpolateViridis } from "d3-scale-chromatic";

/** Names of the maps that a disparity can be shown in. */
export type Scheme = "turbo" | "viridis";

/** 256 colours, four bytes each, from the lowest value to the highest. */
export type Palette = Uint8ClampedArray;

/** The part of turbo that is used: its ends are nearly black and would look invalid. The server's pictures have the same. */
const TURBO_FROM = 0.08;
const TURBO_TO = 0.94;

function palette(color: (share: number) => string): Palette {
  const colors = new Uint8ClampedArray(4 * 256);
  for (let i = 0; i < 256; i++) {
    colors.set([...parse(color(i / 255)), 255], 4 * i);
  }
  return colors;
}

/** Red, green and blue of `rgb(r, g, b)` or `#rrggbb`. */
export function parse(color: string): [number, number, number] {
  const digits = /^#(..)(..)(..)$/.exec(color);
  const parts = digits?.slice(1).map((part) => Number.parseInt(part, 16)) ?? color.match(/\d+/g)?.map(Number);
  const [red = 0, green = 0, blue = 0] = parts ?? [];
  return [red, green, blue];
}

/** The maps of disparities. */
export const PALETTES: Record<Scheme, Palette> = {
  turbo: palette((share) => interpolateTurbo(TURBO_FROM + share * (TURBO_TO - TURBO_FROM))),
  viridis: palette(interpolateViridis),
};

/** The map of confidences. */
export const CONFIDENCE_PALETTE: Palette = palette(interpolateCividis);

/** Index of a value's colour on a scale from `from` to `to`. */
export function place(value: number, from: number, to: number): number {
  const share = (value - from) / Math.max(to - from, Number.EPSILON);
  return Math.round(255 * Math.min(Math.max(share, 0), 1));
}
