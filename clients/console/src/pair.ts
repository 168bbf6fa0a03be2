// The pair that is to be matched: two files, or the sample.

import { create } from "@bufbuild/protobuf";
import { durationFromMs } from "@bufbuild/protobuf/wkt";
import { CalibrationSchema } from "./gen/stereo/v1/calibration_pb.ts";
import { ImageEncoding, ImageSchema } from "./gen/stereo/v1/image_pb.ts";
import { Density, OptionsSchema, Preset } from "./gen/stereo/v1/options_pb.ts";
import { type StereoRequest, StereoRequestSchema } from "./gen/stereo/v1/request_pb.ts";

/** One image file. */
export interface View {
  name: string;
  bytes: Uint8Array;
  encoding: ImageEncoding;
  picture: ImageBitmap;
}

/** Both images. */
export interface Pair {
  left: View;
  right: View;
}

/** Numbers that turn disparities into metres; absent ones have the middle of the image or 0. */
export interface CalibrationInput {
  focalPx: number;
  baselineM: number;
  cxPx?: number;
  cyPx?: number;
  doffsPx?: number;
}

/** Everything that is chosen. */
export interface Choice {
  budgetMs: number;
  preset: "default" | "fast" | "paper";
  density: "dense" | "semi_dense";
  minConfidence: number;
  calibration: CalibrationInput | undefined;
}

/** The file is no image; the message says what to do. */
export class WrongFile extends Error {}

const SIGNATURES: [ImageEncoding, number[]][] = [
  [ImageEncoding.PNG, [0x89, 0x50, 0x4e, 0x47]],
  [ImageEncoding.JPEG, [0xff, 0xd8, 0xff]],
];

/** What kind of image a file is by its first bytes. */
export function encodingOf(bytes: Uint8Array): ImageEncoding | undefined {
  return SIGNATURES.find(([, signature]) => signature.every((byte, i) => bytes[i] === byte))?.[0];
}

/** Reads an image file. */
export async function readView(name: string, blob: Blob): Promise<View> {
  const bytes = new Uint8Array(await blob.arrayBuffer());
  const encoding = encodingOf(bytes);
  if (encoding === undefined) {
    throw new WrongFile(`${name} is neither a PNG nor a JPEG file: choose an image of one of these kinds.`);
  }
  try {
    return { name, bytes, encoding, picture: await createImageBitmap(new Blob([bytes])) };
  } catch {
    throw new WrongFile(`${name} can't be read, it seems to be damaged: save it again or choose another image.`);
  }
}

/** The request for a pair. */
export function requestFor(pair: Pair, choice: Choice): StereoRequest {
  const image = ({ bytes, encoding }: View) => create(ImageSchema, { data: bytes, encoding });
  const { calibration } = choice;
  const request = create(StereoRequestSchema, {
    left: image(pair.left),
    right: image(pair.right),
    options: create(OptionsSchema, {
      latencyBudget: durationFromMs(choice.budgetMs),
      preset: { default: Preset.DEFAULT, fast: Preset.FAST, paper: Preset.PAPER }[choice.preset],
      density: choice.density === "dense" ? Density.DENSE : Density.SEMI_DENSE,
      minConfidence: choice.minConfidence,
    }),
  });
  if (calibration) {
    request.calibration = create(CalibrationSchema, whole(calibration, pair.left.picture));
  }
  return request;
}

/** A calibration without gaps. */
export function whole(calibration: CalibrationInput, { width, height }: { width: number; height: number }): Required<CalibrationInput> {
  return {
    focalPx: calibration.focalPx,
    baselineM: calibration.baselineM,
    cxPx: calibration.cxPx ?? (width - 1) / 2,
    cyPx: calibration.cyPx ?? (height - 1) / 2,
    doffsPx: calibration.doffsPx ?? 0,
  };
}
