// A camera that sends the sample pair over Zenoh, by the Python that has the client and with it Zenoh.

import { type ChildProcess, spawn } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { create, toBinary } from "@bufbuild/protobuf";
import { durationFromMs } from "@bufbuild/protobuf/wkt";
import { CalibrationSchema } from "../src/gen/stereo/v1/calibration_pb.ts";
import { ImageEncoding, ImageSchema } from "../src/gen/stereo/v1/image_pb.ts";
import { Density, OptionsSchema, Output } from "../src/gen/stereo/v1/options_pb.ts";
import { type StereoRequest, StereoRequestSchema } from "../src/gen/stereo/v1/request_pb.ts";
import { target } from "./stereod.ts";

/** A Python that has the client. */
export const python = join(target, "venv-python/bin/python");

/** Why there can be no camera; empty if there can. */
export const noCamera = existsSync(python) ? "" : `there is no ${python} (make test-python)`;

const sample = join(import.meta.dirname, "../public/sample");
const image = (side: string) =>
  create(ImageSchema, { encoding: ImageEncoding.JPEG, data: readFileSync(join(sample, `${side}.jpg`)) });

/** A frame of the sample; it asks for the disparity alone. */
export function frame(minConfidence: number): StereoRequest {
  return create(StereoRequestSchema, {
    left: image("left"),
    right: image("right"),
    calibration: create(CalibrationSchema, JSON.parse(readFileSync(join(sample, "calibration.json"), "utf8"))),
    options: create(OptionsSchema, {
      latencyBudget: durationFromMs(500),
      density: Density.DENSE,
      outputs: [Output.DISPARITY],
      minConfidence,
    }),
  });
}

/** A frame that can't be matched: half of it is missing. */
export function half(): StereoRequest {
  return create(StereoRequestSchema, { left: image("left") });
}

/** A camera that sends. */
export class Camera {
  private constructor(
    private readonly child: ChildProcess,
    private readonly folder: string,
  ) {}

  /** Starts one that sends `frames` in turn. */
  static async start(endpoint: string, name: string, frames: StereoRequest[]): Promise<Camera> {
    const folder = mkdtempSync(join(tmpdir(), "stereod-camera-"));
    const files = frames.map((request, i) => {
      const file = join(folder, `${i}.bin`);
      writeFileSync(file, toBinary(StereoRequestSchema, request));
      return file;
    });
    const script = join(import.meta.dirname, "camera.py");
    const child = spawn(python, [script, endpoint, name, ...files], { stdio: ["ignore", "pipe", "inherit"] });
    await new Promise((resolve, reject) => {
      child.stdout.once("data", resolve);
      child.once("exit", (code) => reject(new Error(`the camera ended with ${code}`)));
    });
    return new Camera(child, folder);
  }

  /** Ends it. */
  async stop(): Promise<void> {
    const gone = new Promise((resolve) => this.child.once("exit", resolve));
    this.child.kill("SIGKILL");
    await gone;
    rmSync(this.folder, { recursive: true });
  }
}
