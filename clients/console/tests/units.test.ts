// What needs no browser.

import { describe, expect, test } from "vitest";
import { create } from "@bufbuild/protobuf";
import { sentence } from "../src/api.ts";
import { budgetMsAt, LAST_PLACE, placeOf } from "../src/budget.ts";
import { PALETTES, parse, place } from "../src/color.ts";
import { count, grouped, ms, short } from "../src/format.ts";
import { DisparitySchema } from "../src/gen/stereo/v1/disparity_pb.ts";
import { ImageEncoding, ImageSchema } from "../src/gen/stereo/v1/image_pb.ts";
import { ExecutionReportSchema } from "../src/gen/stereo/v1/report_pb.ts";
import { type ServerEvent, parse as parseEvent } from "../src/events.ts";
import { depthM, rangeOf, readMaps } from "../src/maps.ts";
import { encodingOf } from "../src/pair.ts";
import { rgbaOf } from "../src/picture.ts";
import { middleRun } from "../src/quality.ts";
import { stagesOf } from "../src/report.ts";
import { asCurl, asPython, type Done, python, shell } from "../src/snippets.ts";
import { type Streams, whyNone } from "../src/streams.ts";

describe("numbers", () => {
  test("are short and have their unit", () => {
    expect([ms(0), ms(4.24), ms(9.96), ms(123.4)]).toEqual(["0 ms", "4.2 ms", "10 ms", "123 ms"]);
    expect([short(0), short(0.01234), short(3.14159), short(31.4159), short(314.159)]).toEqual(["0", "0.0123", "3.14", "31.4", "314"]);
    expect([grouped(1234567), count(1, "worker"), count(2, "worker")]).toEqual(["1\u00a0234\u00a0567", "1 worker", "2 workers"]);
  });

  test("every step of the slider is another budget, and finds its place again", () => {
    const budgets = Array.from({ length: LAST_PLACE + 1 }, (_, i) => budgetMsAt(i));
    expect(budgets).toEqual([...new Set(budgets)].sort((a, b) => a - b));
    expect(budgets.map(placeOf)).toEqual(budgets.map((_, i) => i));
    expect([placeOf(1), placeOf(55), placeOf(1e6)]).toEqual([0, placeOf(50), LAST_PLACE]);
  });

  test("a sentence starts with a capital and ends with a full stop", () => {
    expect(sentence("the queue is full")).toBe("The queue is full.");
    expect(sentence("Is it?")).toBe("Is it?");
  });
});

describe("maps", () => {
  const bytes = (values: number[]) => {
    const view = new DataView(new ArrayBuffer(2 * values.length));
    values.forEach((value, i) => view.setUint16(2 * i, value, true));
    return new Uint8Array(view.buffer);
  };

  test("are read with padded rows or without", () => {
    for (const [step, data] of [[4, bytes([256, 0, 640, 512])], [6, bytes([256, 0, 9, 640, 512, 9])]] as const) {
      const maps = readMaps(create(DisparitySchema, { width: 2, height: 2, step, data }));
      expect([...maps.disparity]).toEqual([256, 0, 640, 512]);
    }
  });

  test("a few wild disparities leave the scale to the rest", () => {
    const calm = Uint16Array.from({ length: 1000 }, (_, i) => 256 * 10 + i);
    const wild = calm.map((fixed, i) => (i % 100 === 0 ? 0xffff : fixed));
    const [one, two] = [rangeOf(calm), rangeOf(wild)];
    expect(Math.abs(one.from - two.from) + Math.abs(one.to - two.to)).toBeLessThan(0.2);
    expect(rangeOf(new Uint16Array(4))).toEqual({ from: 0, to: 0 });
  });

  test("depth follows from the calibration", () => {
    const calibration = { $typeName: "stereo.v1.Calibration" as const, focalPx: 500, cxPx: 0, cyPx: 0, baselineM: 0.1, doffsPx: 5 };
    expect(depthM(20, calibration)).toBe(2);
  });

  test("near is warm and far is cold", () => {
    const color = (palette: Uint8ClampedArray, i: number) => [...palette.slice(4 * i, 4 * i + 4)];
    const [farRed = 0, , farBlue = 0] = color(PALETTES.turbo, 0);
    const [nearRed = 0, , nearBlue = 0] = color(PALETTES.turbo, 255);
    expect(farBlue).toBeGreaterThan(farRed);
    expect(nearRed).toBeGreaterThan(nearBlue);
    expect(color(PALETTES.viridis, 0)).toEqual([...parse("#440154"), 255]);
    expect([place(-1, 0, 10), place(5, 0, 10), place(99, 0, 10), place(3, 3, 3)]).toEqual([0, 128, 255, 0]);
  });
});

describe("a report", () => {
  test("has all of its time in a stage", () => {
    const duration = (millis: number) => ({ seconds: 0n, nanos: millis * 1e6 });
    const report = create(ExecutionReportSchema, { received: duration(1), matched: duration(4), total: duration(7) });
    const stages = stagesOf(report);
    expect(stages.reduce((sum, stage) => sum + stage.ms, 0)).toBe(7);
    expect(stages.at(-1)).toEqual({ name: "other", ms: 2 });
  });

  test("of several runs, the one in the middle counts, refusals last", () => {
    const run = (totalMs?: number) => (totalMs === undefined ? { budgetMs: 5 } : { budgetMs: 5, totalMs });
    expect(middleRun([run(9), run(), run(4)]).totalMs).toBe(9);
    expect(middleRun([run(), run(4), run()]).totalMs).toBeUndefined();
  });
});

describe("files", () => {
  test("are known by how they start", () => {
    expect(encodingOf(Uint8Array.of(0x89, 0x50, 0x4e, 0x47, 0))).toBe(ImageEncoding.PNG);
    expect(encodingOf(Uint8Array.of(0xff, 0xd8, 0xff, 0xe0))).toBe(ImageEncoding.JPEG);
    expect(encodingOf(Uint8Array.of(0x47, 0x49, 0x46))).toBeUndefined();
    expect(encodingOf(new Uint8Array())).toBeUndefined();
  });
});

describe("pictures", () => {
  test("are made of gray and of colour alike", () => {
    const gray = create(ImageSchema, { encoding: ImageEncoding.MONO8, width: 2, height: 1, data: Uint8Array.of(7, 200) });
    expect([...(rgbaOf(gray) ?? [])]).toEqual([7, 7, 7, 255, 200, 200, 200, 255]);
    const color = create(ImageSchema, { encoding: ImageEncoding.RGB8, width: 1, height: 1, data: Uint8Array.of(1, 2, 3) });
    expect([...(rgbaOf(color) ?? [])]).toEqual([1, 2, 3, 255]);
    expect(rgbaOf(create(ImageSchema, { encoding: ImageEncoding.PNG }))).toBeUndefined();
  });
});

describe("commands", () => {
  const done: Done = {
    server: "http://127.0.0.1:8080",
    left: "it's left.png",
    right: "right.png",
    isSample: false,
    needsToken: false,
    size: { width: 641, height: 481 },
    choice: { budgetMs: 50, preset: "fast", density: "dense", minConfidence: 0.5, calibration: { focalPx: 500, baselineM: 0.1 } },
  };

  test("survive odd names", () => {
    expect(shell("it's $HOME")).toBe(`'it'\\''s $HOME'`);
    expect(python('a "b" \\')).toBe('"a \\"b\\" \\\\"');
    expect(asCurl(done)).toContain(`left=@'it'\\''s left.png'`);
  });

  test("say what was chosen", () => {
    const options = /options=(\{.*\})'/.exec(asCurl(done))?.[1] ?? "";
    expect(JSON.parse(options)).toEqual({
      latency_budget_ms: 50,
      preset: "fast",
      density: "dense",
      min_confidence: 0.5,
      calibration: { focal_px: 500, cx_px: 320, cy_px: 240, baseline_m: 0.1, doffs_px: 0 },
    });
    expect(asPython(done)).toContain('budget_ms=50, preset="fast", density="dense", min_confidence=0.5, calibration=calibration');
  });

  test("take the token from the environment, where the server asks for one", () => {
    const secret = { ...done, needsToken: true };
    expect(asCurl(secret)).toContain('-H "Authorization: Bearer $STEREO_TOKEN"');
    expect(asPython(secret)).toMatch(/^from os import environ\n[^]*token=environ\["STEREO_TOKEN"\]/);
    expect(asCurl(done) + asPython(done)).not.toMatch(/token/i);
  });

  test("get the sample first", () => {
    expect(asCurl({ ...done, isSample: true, left: "left.jpg" })).toMatch(/^curl -s -O http:\/\/127.0.0.1:8080\/sample\/left.jpg/);
  });
});

describe("events", () => {
  test("have a name and data; comments have none", () => {
    const cases: [string, ServerEvent][] = [
      ["event: result\ndata: {}", { name: "result", data: "{}" }],
      ["data:a\r\ndata: b", { name: "message", data: "a\nb" }],
      [": still there", { name: "message", data: "" }],
    ];
    for (const [block, event] of cases) {
      expect(parseEvent(block)).toEqual(event);
    }
  });
});

describe("no camera", () => {
  const none: Streams = { streams: [], zenoh: { state: "open", connections: 0 } };

  test("has a reason that says what to do", () => {
    expect(whyNone(none)).toMatch(/puts frames to stereo\/v1\/frames\/NAME/);
    expect(whyNone({ ...none, zenoh: { state: "off", connections: 0 } })).toMatch(/without --no-zenoh/);
    expect(whyNone({ ...none, zenoh: { state: "opening", connections: 0, why: "the port is taken" } })).toBe("The port is taken.");
  });
});
