// The page "Try it": a pair, a budget, and what comes back.

import { type Answer, info, match, Refused, Unreachable } from "./api.ts";
import { budgetMsAt, LAST_PLACE, placeOf } from "./budget.ts";
import { find, say } from "./dom.ts";
import { hasToken } from "./door.ts";
import { ms } from "./format.ts";
import { type CalibrationInput, type Choice, type Pair, readView, requestFor, type View, WrongFile } from "./pair.ts";
import { BUDGETS_MS, middleRun, RUNS, type Run, showQuality } from "./quality.ts";
import { inMs, showReport, summary } from "./report.ts";
import { asCurl, asPython } from "./snippets.ts";
import { Views } from "./views.ts";

type Side = "left" | "right";
const SIDES: Side[] = ["left", "right"];
/** The server's own default. */
const FIRST_BUDGET_MS = 100;

/** The page. */
export class TryPage {
  readonly #views = new Views("[data-views=try]");
  readonly #budget = find<HTMLInputElement>("#budget");
  readonly #confidence = find<HTMLInputElement>("#confidence");
  readonly #preset = find<HTMLSelectElement>("#preset");
  readonly #density = find<HTMLSelectElement>("#density");
  readonly #match = find<HTMLButtonElement>("#match");
  readonly #measure = find<HTMLButtonElement>("#measure");
  readonly #problem = find("#problem");
  readonly #said = find("#said");
  readonly #images: Partial<Record<Side, View>> = {};
  #isSample = false;
  /** Ends what is under way. */
  #underway: AbortController | undefined;
  #isBusy = false;
  #isWanted = false;
  #failedUnreachable = false;

  constructor() {
    this.#budget.max = String(LAST_PLACE);
    this.#budget.value = String(placeOf(FIRST_BUDGET_MS));
    this.#label();
    for (const control of [this.#budget, this.#confidence, this.#preset, this.#density]) {
      control.addEventListener("input", () => {
        this.#label();
        this.#want();
      });
    }
    find("#calibration").addEventListener("change", () => {
      this.#label();
      this.#want();
    });
    find("#controls").addEventListener("submit", (event) => {
      event.preventDefault();
      if (!this.#pair()) {
        this.#fail("Two images are needed: choose a left and a right one, or use the sample.");
      }
      this.#want();
    });
    find("#sample").addEventListener("click", () => void this.useSample());
    this.#measure.addEventListener("click", () => void this.#runBudgets());
    this.#takeFiles();
    for (const id of ["#curl", "#python"]) {
      this.#copies(id);
    }
  }

  /** Loads the server's own pair and matches it. */
  async useSample(): Promise<void> {
    try {
      const calibration: CalibrationInput = await (await fetch("./sample/calibration.json")).json();
      for (const side of SIDES) {
        await this.#take(side, `${side}.jpg`, await (await fetch(`./sample/${side}.jpg`)).blob());
      }
      this.#isSample = true;
      this.#setCalibration(calibration);
      this.#want();
    } catch (error) {
      this.#failWith(error instanceof WrongFile ? error : new Unreachable());
    }
  }

  /** The server is back: what failed because it was away is done now. */
  async reconnected(): Promise<void> {
    if (this.#failedUnreachable) {
      this.#failedUnreachable = false;
      await (this.#pair() ? this.#want() : this.useSample());
    }
  }

  #choice(): Choice {
    return {
      budgetMs: budgetMsAt(this.#budget.valueAsNumber),
      preset: this.#preset.value as Choice["preset"],
      density: this.#density.value as Choice["density"],
      minConfidence: this.#confidence.valueAsNumber,
      calibration: this.#calibration(),
    };
  }

  #pair(): Pair | undefined {
    const { left, right } = this.#images;
    return left && right ? { left, right } : undefined;
  }

  #label(): void {
    const budget = ms(budgetMsAt(this.#budget.valueAsNumber)).replace(".0 ", " ");
    find("#budget-text").textContent = budget;
    this.#budget.setAttribute("aria-valuetext", budget);
    const confidence = this.#confidence.valueAsNumber;
    find("#confidence-text").textContent = confidence === 0 ? "any" : confidence.toFixed(2);
    const calibration = this.#calibration();
    find("#calibration-text").textContent = calibration
      ? `${calibration.focalPx} px, ${calibration.baselineM} m`
      : "none: results are in pixels";
  }

  /** Matches now, or as soon as what is under way has ended; only the newest wish counts. */
  async #want(): Promise<void> {
    this.#isWanted = true;
    if (this.#isBusy) {
      return;
    }
    this.#isBusy = true;
    while (this.#isWanted) {
      this.#isWanted = false;
      await this.#once();
    }
    this.#isBusy = false;
  }

  async #once(): Promise<void> {
    const pair = this.#pair();
    if (!pair) {
      return;
    }
    const choice = this.#choice();
    this.#match.setAttribute("aria-busy", "true");
    this.#underway = new AbortController();
    try {
      const answer = await match(requestFor(pair, choice), this.#underway.signal);
      this.#show(pair, choice, answer);
    } catch (error) {
      this.#failWith(error);
    }
    this.#match.removeAttribute("aria-busy");
  }

  #show(pair: Pair, choice: Choice, { result, roundTripMs }: Answer): void {
    say(this.#problem, "");
    this.#failedUnreachable = false;
    this.#views.showLeft(pair.left.picture);
    this.#views.show(result);
    if (result.report) {
      showReport(find("#report"), result.report, roundTripMs);
      say(this.#said, summary(result.report));
    }
    const { width, height } = pair.left.picture;
    const done = {
      server: location.origin,
      left: pair.left.name,
      right: pair.right.name,
      isSample: this.#isSample,
      needsToken: hasToken(),
      size: { width, height },
      choice,
    };
    find("#curl pre").textContent = asCurl(done);
    find("#python pre").textContent = asPython(done);
  }

  async #runBudgets(): Promise<void> {
    const pair = this.#pair();
    if (!pair || this.#measure.getAttribute("aria-busy")) {
      return;
    }
    this.#measure.setAttribute("aria-busy", "true");
    const choice = this.#choice();
    const element = find("#quality");
    const runs: Run[] = [];
    try {
      const { presets } = await info();
      const rungs = presets.find((preset) => preset.name === choice.preset)?.rungs.length ?? 1;
      for (const budgetMs of BUDGETS_MS) {
        const same: Run[] = [];
        for (let i = 0; i < RUNS; i++) {
          same.push(await this.#run(pair, { ...choice, budgetMs }));
        }
        runs.push(middleRun(same));
        showQuality(element, runs, rungs);
      }
      say(this.#said, `${BUDGETS_MS.length} budgets tried: see how quality follows the budget.`);
    } catch (error) {
      this.#failWith(error);
    }
    this.#measure.removeAttribute("aria-busy");
  }

  /** One run; a budget that can't be met is a result as well. */
  async #run(pair: Pair, choice: Choice): Promise<Run> {
    const { budgetMs } = choice;
    try {
      const { result } = await match(requestFor(pair, choice), new AbortController().signal);
      const report = result.report;
      return report
        ? {
            budgetMs,
            totalMs: inMs(report.total),
            quality: report.qualityEstimate,
            rungs: report.iterationsRun,
            rung: report.rung,
          }
        : { budgetMs };
    } catch (error) {
      if (error instanceof Refused && ["DEADLINE_INFEASIBLE", "EXPIRED", "QUEUE_FULL", "QUOTA"].includes(error.reason)) {
        return { budgetMs };
      }
      throw error;
    }
  }

  #failWith(error: unknown): void {
    if (error instanceof DOMException && error.name === "AbortError") {
      return;
    }
    this.#failedUnreachable = error instanceof Unreachable;
    this.#fail(error instanceof Error ? error.message : String(error));
  }

  #fail(text: string): void {
    say(this.#said, "");
    say(this.#problem, text);
  }

  // The pair.

  #takeFiles(): void {
    for (const side of SIDES) {
      const drop = find(`[data-side=${side}]`);
      const input = find<HTMLInputElement>("input", drop);
      input.addEventListener("change", () => void this.#choose(side, [...(input.files ?? [])]));
    }
    const page = find("#try");
    const over = (isOver: boolean) => page.classList.toggle("over", isOver);
    page.addEventListener("dragover", (event) => {
      event.preventDefault();
      over(true);
    });
    page.addEventListener("dragleave", (event) => over(page.contains(event.relatedTarget as Node | null)));
    page.addEventListener("drop", (event) => {
      event.preventDefault();
      over(false);
      const target = event.target instanceof Element ? event.target.closest<HTMLElement>("[data-side]") : null;
      void this.#choose((target?.dataset.side as Side) ?? "left", [...(event.dataTransfer?.files ?? [])]);
    });
  }

  /** Files that the user chose: one for `side`, or two for both, by their names where these tell. */
  async #choose(side: Side, files: File[]): Promise<void> {
    const [one, two] = files;
    if (!one) {
      return;
    }
    try {
      const other = side === "left" ? "right" : "left";
      if (two) {
        const swapped = /right|im1|_r\b/i.test(one.name) && !/right|im1|_r\b/i.test(two.name);
        await this.#take("left", (swapped ? two : one).name, swapped ? two : one);
        await this.#take("right", (swapped ? one : two).name, swapped ? one : two);
      } else {
        await this.#take(side, one.name, one);
        if (this.#isSample) {
          this.#drop(other);
        }
      }
      if (this.#isSample) {
        this.#isSample = false;
        this.#setCalibration(undefined);
      }
      say(this.#problem, "");
      say(this.#said, this.#pair() ? "" : `Now choose the ${other} image.`);
      await this.#want();
    } catch (error) {
      this.#failWith(error);
    }
  }

  async #take(side: Side, name: string, blob: Blob): Promise<void> {
    const view = await readView(name, blob);
    this.#images[side] = view;
    const drop = find(`[data-side=${side}]`);
    drop.dataset.state = "full";
    find(".name", drop).textContent = name;
    const canvas = find<HTMLCanvasElement>("canvas", drop);
    canvas.width = 240;
    canvas.height = Math.round((240 * view.picture.height) / view.picture.width);
    canvas.getContext("2d")?.drawImage(view.picture, 0, 0, canvas.width, canvas.height);
    if (side === "left") {
      this.#views.clear("");
      this.#views.showLeft(view.picture);
    }
  }

  /** One half of the sample, which doesn't go with the user's own image. */
  #drop(side: Side): void {
    delete this.#images[side];
    const drop = find(`[data-side=${side}]`);
    delete drop.dataset.state;
    find(".name", drop).textContent = side === "left" ? "Left image" : "Right image";
    find<HTMLCanvasElement>("canvas", drop).width = 4;
    find<HTMLCanvasElement>("canvas", drop).height = 3;
    this.#views.clear("");
  }

  // The calibration.

  #calibration(): CalibrationInput | undefined {
    const value = (id: string) => find<HTMLInputElement>(`#${id}`).valueAsNumber;
    const [focalPx, baselineM] = [value("focal"), value("baseline")];
    if (Number.isNaN(focalPx) || Number.isNaN(baselineM)) {
      return undefined;
    }
    const calibration: CalibrationInput = { focalPx, baselineM };
    for (const [id, name] of [["cx", "cxPx"], ["cy", "cyPx"], ["doffs", "doffsPx"]] as const) {
      if (!Number.isNaN(value(id))) {
        calibration[name] = value(id);
      }
    }
    return calibration;
  }

  #setCalibration(calibration: CalibrationInput | undefined): void {
    const fields = { focal: "focalPx", baseline: "baselineM", cx: "cxPx", cy: "cyPx", doffs: "doffsPx" } as const;
    for (const [id, name] of Object.entries(fields)) {
      find<HTMLInputElement>(`#${id}`).value = String(calibration?.[name] ?? "");
    }
    this.#label();
  }

  #copies(id: string): void {
    const button = find(`${id} button`);
    button.addEventListener("click", async () => {
      const code = find(`${id} pre`);
      try {
        await navigator.clipboard.writeText(code.textContent ?? "");
        button.textContent = "Copied";
      } catch {
        // Without https, browsers give pages no clipboard: the text is selected instead.
        getSelection()?.selectAllChildren(code);
        button.textContent = "Selected: press Ctrl+C";
      }
      setTimeout(() => {
        button.textContent = "Copy";
      }, 2000);
    });
  }
}
