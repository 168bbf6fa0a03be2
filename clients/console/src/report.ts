// The report of one frame: where its budget went.

import type { Duration } from "@bufbuild/protobuf/wkt";
import { make } from "./dom.ts";
import { ms, percent } from "./format.ts";
import type { ExecutionReport } from "./gen/stereo/v1/report_pb.ts";

/** A stage and how long it took, in ms. */
export interface Stage {
  name: string;
  ms: number;
}

/** A duration in ms, 0 if it wasn't sent. */
export function inMs(duration: Duration | undefined): number {
  return duration ? Number(duration.seconds) * 1e3 + duration.nanos / 1e6 : 0;
}

/** The stages in their order; the last is what is in none of them. */
export function stagesOf(report: ExecutionReport): Stage[] {
  const stages = [
    { name: "receive", ms: inMs(report.received) },
    { name: "queue", ms: inMs(report.queued) },
    { name: "decode", ms: inMs(report.decoded) },
    { name: "match", ms: inMs(report.matched) },
    { name: "mesh", ms: inMs(report.meshed) },
    { name: "encode", ms: inMs(report.encoded) },
  ];
  const named = stages.reduce((sum, stage) => sum + stage.ms, 0);
  return [...stages, { name: "other", ms: Math.max(inMs(report.total) - named, 0) }];
}

/** One sentence about a frame. */
export function summary(report: ExecutionReport): string {
  const budget = report.budget ? ` of ${ms(inMs(report.budget))}` : "";
  const rungs = `${report.iterationsRun} of ${report.iterationsAsked} rungs (${report.rung})`;
  const late = report.deadlineMet ? "" : "Late: ";
  return `${late}${ms(inMs(report.total))}${budget}, ${rungs}, estimated quality ${percent(report.qualityEstimate)}.`;
}

/** Fills `element` with the bar of stages against the budget, and the facts. */
export function showReport(element: HTMLElement, report: ExecutionReport, roundTripMs: number): void {
  const stages = stagesOf(report);
  const budget = inMs(report.budget);
  const total = inMs(report.total);
  const end = Math.max(budget, total);
  const bar = make("div", { class: "bar", role: "img", "aria-label": `${ms(total)} used of ${ms(budget)}` });
  for (const stage of stages) {
    const part = make("i", { "data-stage": stage.name, title: `${stage.name} ${ms(stage.ms)}` });
    part.style.width = `${(100 * stage.ms) / end}%`;
    bar.append(part);
  }
  const mark = make("b", {});
  mark.style.left = `${(100 * budget) / end}%`;
  bar.append(mark);
  const scale = make("p", { class: "scale" }, make("span", {}, `used ${ms(total)}`), make("span", {}, `budget ${ms(budget)}`));
  const key = make(
    "ul",
    { class: "key" },
    ...stages.map(({ name, ms: took }) =>
      make("li", {}, make("i", { "data-stage": name, "aria-hidden": "true" }), `${name} `, make("b", {}, ms(took))),
    ),
  );
  const facts: [string, string][] = [
    ["Rungs", `${report.iterationsRun} of ${report.iterationsAsked}, the last: ${report.rung}`],
    ["Estimated quality", `${percent(report.qualityEstimate)} right within 3 px`],
    ["Density", percent(report.density)],
    ["Cost", `${ms(inMs(report.actualCost))}, predicted ${ms(inMs(report.predictedCost))}`],
    ["Deadline", report.deadlineMet ? "met" : "missed"],
    ["Cut", report.degradation || "nothing"],
    ["Round trip", `${ms(roundTripMs)} in this browser`],
    ["Server", `${report.instance}, worker ${report.worker}, ${report.queueDepth} waiting`],
  ];
  const list = make(
    "dl",
    { class: "facts" },
    ...facts.map(([term, fact]) => make("div", {}, make("dt", {}, term), make("dd", fact === "missed" ? { class: "bad" } : {}, fact))),
  );
  element.replaceChildren(bar, scale, key, list);
}
