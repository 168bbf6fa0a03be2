// How quality follows the budget: the same pair with one budget after the other, and a plot of what came back.

import { draw, make, table } from "./dom.ts";
import { ms, percent } from "./format.ts";

/** The budgets that are tried, in ms. */
export const BUDGETS_MS = [2, 3, 5, 8, 12, 20, 35, 60, 120, 250, 500];
/** Runs of each; the middle one by time is shown. */
export const RUNS = 3;

/** What came back for one budget; a refusal has no numbers. */
export interface Run {
  budgetMs: number;
  totalMs?: number;
  quality?: number;
  rungs?: number;
  rung?: string;
}

/** The run with the middle time; a refusal if most were refused. */
export function middleRun(runs: Run[]): Run {
  const inOrder = [...runs].sort((a, b) => (a.totalMs ?? Number.POSITIVE_INFINITY) - (b.totalMs ?? Number.POSITIVE_INFINITY));
  return inOrder[inOrder.length >> 1] ?? { budgetMs: 0 };
}

const WIDTH = 720;
const LEFT = 52;
const RIGHT = 14;
const PLOT = { top: 16, height: 128 };
const GAP = 34;

/** Fills `element` with two plots over the budget, quality and time, and the same as a table. */
export function showQuality(element: HTMLElement, runs: Run[], rungsAsked: number): void {
  const answered = runs.filter((run) => run.totalMs !== undefined);
  const first = BUDGETS_MS[0] ?? 1;
  const last = BUDGETS_MS.at(-1) ?? 1;
  const x = (budgetMs: number) =>
    LEFT + ((WIDTH - LEFT - RIGHT) * Math.log(budgetMs / first)) / Math.log(last / first);
  const height = PLOT.top + 2 * PLOT.height + GAP + 38;
  const svg = draw("svg", { viewBox: `0 0 ${WIDTH} ${height}`, class: "plot", role: "img" });
  svg.setAttribute("aria-label", "Estimated quality and time over the latency budget; the table below has the numbers");

  const lowest = Math.min(1, ...answered.map((run) => run.quality ?? 0));
  const floor = Math.min(0.9, Math.max(0, Math.floor(lowest * 10 - 0.5) / 10));
  const yQuality = (share: number) => PLOT.top + PLOT.height * (1 - (share - floor) / (1 - floor));
  const shares = [floor, (1 + floor) / 2, 1];
  axis(svg, "estimated quality", shares.map((share) => [yQuality(share), percent(share)]));
  line(svg, "quality", answered.map((run) => [x(run.budgetMs), yQuality(run.quality ?? 0)]));
  let named = "";
  for (const run of answered) {
    const at = { cx: x(run.budgetMs), cy: yQuality(run.quality ?? 0) };
    svg.append(draw("circle", { ...at, r: 2 + 5 * ((run.rungs ?? 0) / Math.max(rungsAsked, 1)), class: "rung" }));
    if (run.rung && run.rung !== named) {
      named = run.rung;
      svg.append(draw("text", { x: at.cx, y: Math.min(at.cy + 22, PLOT.top + PLOT.height - 6), class: "name" }, named));
    }
  }

  const top = PLOT.top + PLOT.height + GAP;
  const bottom = top + PLOT.height;
  const most = Math.max(...answered.map((run) => run.totalMs ?? 0), 1) * 1.25;
  const yTime = (time: number) => bottom - (PLOT.height * Math.min(time, most)) / most;
  axis(svg, "time taken", [0, most / 2, most].map((time) => [yTime(time), ms(time)]));
  const diagonal = Array.from({ length: 61 }, (_, i) => first * (last / first) ** (i / 60)).filter((time) => time <= most);
  line(svg, "budget", diagonal.map((time) => [x(time), yTime(time)]));
  line(svg, "time", answered.map((run) => [x(run.budgetMs), yTime(run.totalMs ?? 0)]));
  for (const run of runs) {
    const label = draw("text", { x: x(run.budgetMs), y: bottom + 16, class: "tick" }, String(run.budgetMs));
    svg.append(label);
    if (run.totalMs === undefined) {
      svg.append(draw("text", { x: x(run.budgetMs), y: bottom - 5, class: "refused" }, "✕"));
    } else {
      svg.append(draw("circle", { cx: x(run.budgetMs), cy: yTime(run.totalMs), r: 3, class: "time" }));
    }
  }
  svg.append(draw("text", { x: (WIDTH + LEFT) / 2, y: bottom + 34, class: "tick" }, "latency budget, ms"));

  const rows = runs.map((run) => [
    ms(run.budgetMs),
    run.totalMs === undefined ? "refused" : ms(run.totalMs),
    run.rungs === undefined ? "" : `${run.rungs} (${run.rung})`,
    run.quality === undefined ? "" : percent(run.quality),
  ]);
  const numbers = table("Quality over the budget", ["Budget", "Time", "Rungs", "Estimated quality"], rows);
  const refused = runs.some((run) => run.totalMs === undefined) ? " ✕: the budget can't be met, refused at once." : "";
  const note = `Circles grow with the rungs; the dashed line is the budget itself.${refused}`;
  element.replaceChildren(
    svg,
    make("p", { class: "hint" }, note),
    make("details", {}, make("summary", {}, "The numbers"), numbers),
  );
}

function axis(svg: SVGElement, title: string, ticks: [number, string][]): void {
  for (const [y, text] of ticks) {
    svg.append(
      draw("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y, class: "grid" }),
      draw("text", { x: LEFT - 8, y: y + 4, class: "tick end" }, text),
    );
  }
  const top = Math.min(...ticks.map(([y]) => y));
  svg.append(draw("text", { x: LEFT, y: top - 5, class: "title" }, title));
}

function line(svg: SVGElement, kind: string, points: [number, number][]): void {
  const path = points.map(([x, y], i) => `${i === 0 ? "M" : "L"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
  svg.append(draw("path", { d: path, class: `line ${kind}` }));
}
