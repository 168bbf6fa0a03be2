// The last frames of a camera: the time each took under the budget it had.

import { draw } from "./dom.ts";
import { ms } from "./format.ts";
import type { FrameEvent } from "./streams.ts";

const KEPT = 150;
const WIDTH = 720;
const HEIGHT = 190;
const LEFT = 52;
const TOP = 14;
const BOTTOM = HEIGHT - 22;

/** The frames that are remembered, oldest first. */
export class Timeline {
  readonly #frames: FrameEvent[] = [];

  /** One more frame. */
  add(frame: FrameEvent): void {
    this.#frames.push(frame);
    if (this.#frames.length > KEPT) {
      this.#frames.shift();
    }
  }

  /** Forgets all. */
  clear(): void {
    this.#frames.length = 0;
  }

  /** What the frames have in common, in words. */
  get summary(): string {
    const results = this.#frames.flatMap((frame) => (frame.kind === "result" ? [frame.report] : []));
    const last = results.at(-1);
    if (!last) {
      return "No frame yet.";
    }
    const met = results.filter((report) => report.deadline_met).length;
    const dropped = this.#frames.length - results.length;
    const times = results.map((report) => report.total_ms).sort((a, b) => a - b);
    const middle = ms(times[times.length >> 1] ?? 0);
    const why = last.degradation ? ` (${last.degradation})` : "";
    return (
      `The last ${this.#frames.length} frames: ${middle} in the middle, ${met} in budget, ${dropped} dropped. ` +
      `Now ${last.iterations_run} of ${last.iterations_asked} rungs${why}.`
    );
  }

  /** The frames as a picture. */
  picture(): SVGElement {
    const svg = draw("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "plot frames", role: "img", "aria-label": this.summary });
    const reports = this.#frames.flatMap((frame) => (frame.kind === "result" ? [frame.report] : []));
    const most = 1.1 * Math.max(...reports.map((report) => Math.max(report.budget_ms, report.total_ms)), 1);
    const y = (time: number) => BOTTOM - ((BOTTOM - TOP) * time) / most;
    for (const time of [0, most / 2, most]) {
      svg.append(
        draw("line", { x1: LEFT, x2: WIDTH, y1: y(time), y2: y(time), class: "grid" }),
        draw("text", { x: LEFT - 8, y: y(time) + 4, class: "tick end" }, ms(time)),
      );
    }
    const step = (WIDTH - LEFT) / KEPT;
    let budget = "";
    this.#frames.forEach((frame, i) => {
      const x = WIDTH - (this.#frames.length - i) * step;
      if (frame.kind === "dropped") {
        svg.append(draw("rect", { x, y: BOTTOM - 10, width: step * 0.75, height: 10, class: "dropped" }));
        return;
      }
      const { report } = frame;
      const share = report.iterations_run / Math.max(report.iterations_asked, 1);
      const height = BOTTOM - y(report.total_ms);
      const kind = report.deadline_met ? (share < 1 ? "fewer" : "whole") : "late";
      svg.append(draw("rect", { x, y: BOTTOM - height, width: step * 0.75, height, class: kind }));
      const at = y(report.budget_ms).toFixed(1);
      budget += `${budget === "" ? "M" : "L"}${x.toFixed(1)} ${at}L${(x + step).toFixed(1)} ${at}`;
    });
    svg.append(draw("path", { d: budget, class: "line budget" }));
    svg.append(draw("text", { x: WIDTH, y: HEIGHT - 6, class: "tick end" }, "now"));
    return svg;
  }
}
