// The page "Live": the cameras that this server serves, and one of them frame by frame.

import { latest, Refused } from "./api.ts";
import { find, make, say, table } from "./dom.ts";
import { count, grouped } from "./format.ts";
import { follow, type Network, type Stream, type Streams, streams, whyNone } from "./streams.ts";
import { Timeline } from "./timeline.ts";
import { pictureOf } from "./picture.ts";
import { Views } from "./views.ts";

/** How often the list of cameras is asked for, in ms. */
const LIST_EVERY_MS = 1000;
/** How often the timeline is drawn anew. */
const DRAW_EVERY_MS = 250;
/** How long to wait before asking again when there is no frame. */
const PAUSE_MS = 500;

const pause = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));

/** The page. */
export class LivePage {
  readonly #views = new Views("[data-views=live]");
  readonly #timeline = new Timeline();
  readonly #cameras = find("#cameras");
  readonly #problem = find("#live-problem");
  /** Ends what goes on while the page is open. */
  #open: AbortController | undefined;
  /** Ends what goes on for one camera. */
  #watch: AbortController | undefined;
  #camera: string | undefined;
  #wanted: string | undefined;

  /** Shows the page with a camera, or with the first there is. */
  open(camera: string | undefined): void {
    this.#wanted = camera;
    if (camera !== undefined) {
      this.#select(camera);
    }
    if (!this.#open) {
      this.#open = new AbortController();
      void this.#list(this.#open.signal);
    }
  }

  /** Ends everything that goes on. */
  close(): void {
    this.#open?.abort();
    this.#watch?.abort();
    this.#open = undefined;
    this.#watch = undefined;
    this.#camera = undefined;
  }

  async #list(signal: AbortSignal): Promise<void> {
    while (!signal.aborted) {
      try {
        const all = await streams(signal);
        if (!signal.aborted) {
          this.#showList(all);
        }
      } catch (error) {
        const missing = error instanceof Refused && error.status === 404;
        if (missing) {
          say(find("#cameras-hint"), "This server takes no camera streams: start it without --no-zenoh to see cameras here.");
        }
        // Any other trouble is the banner's, and over when the server is back.
      }
      await pause(LIST_EVERY_MS);
    }
  }

  #showList(all: Streams): void {
    say(find("#cameras-hint"), whyNone(all));
    const first = all.streams.find((stream) => stream.served) ?? all.streams[0];
    if (this.#wanted === undefined && this.#camera === undefined && first) {
      this.#select(first.camera);
    }
    const items = all.streams.map((stream) => this.#item(stream));
    // The list is replaced as a whole only if it has changed, so that the focus stays where it is.
    if (this.#cameras.innerHTML !== make("ul", {}, ...items).innerHTML) {
      const focused = document.activeElement?.getAttribute("href");
      this.#cameras.replaceChildren(...all.streams.map((stream) => this.#item(stream)));
      if (focused) {
        this.#cameras.querySelector<HTMLElement>(`[href="${CSS.escape(focused)}"]`)?.focus();
      }
    }
    showFleet(find("#fleet"), all.zenoh);
    const chosen = all.streams.find((stream) => stream.camera === this.#camera);
    if (chosen) {
      showCounts(find("#counts"), chosen);
    } else {
      find("#counts").replaceChildren(make("p", { class: "hint" }, "No camera is chosen."));
    }
    if (this.#camera !== undefined && !chosen) {
      say(this.#problem, `No camera ${this.#camera} has sent a frame to this server: start it, or choose another one.`);
    }
  }

  #item({ camera, served, rates }: Stream): HTMLLIElement {
    const link = make("a", { href: `#/live/${encodeURIComponent(camera)}`, "data-state": served ? "served" : "gone" });
    if (camera === this.#camera) {
      link.setAttribute("aria-current", "true");
    }
    const rate = served ? `${rates.received_hz.toFixed(0)} Hz` : "gone";
    link.append(make("span", {}, camera), make("span", { class: "rate" }, rate));
    return make("li", {}, link);
  }

  #select(camera: string): void {
    if (camera === this.#camera) {
      return;
    }
    this.#watch?.abort();
    this.#watch = new AbortController();
    this.#camera = camera;
    this.#timeline.clear();
    this.#views.clear("Waiting for a frame.");
    say(this.#problem, "");
    const { signal } = this.#watch;
    void follow(camera, signal, (event) => this.#timeline.add(event));
    const drawing = setInterval(() => this.#draw(), DRAW_EVERY_MS);
    signal.addEventListener("abort", () => clearInterval(drawing));
    this.#draw();
    void this.#show(camera, signal);
  }

  #draw(): void {
    find("#frames").replaceChildren(this.#timeline.picture(), make("p", { class: "hint" }, this.#timeline.summary), key());
  }

  /** Shows one frame after the other, as fast as they come and this browser can. */
  async #show(camera: string, signal: AbortSignal): Promise<void> {
    while (!signal.aborted) {
      if (document.hidden) {
        await pause(PAUSE_MS);
        continue;
      }
      try {
        const { result, left } = await latest(camera, signal);
        const picture = left && (await pictureOf(left));
        if (signal.aborted) {
          return;
        }
        if (picture) {
          this.#views.showLeft(picture);
        }
        if (result) {
          this.#views.show(result);
        }
        say(this.#problem, "");
        await new Promise(requestAnimationFrame);
      } catch (error) {
        if (signal.aborted) {
          return;
        }
        if (error instanceof Refused) {
          say(this.#problem, error.message);
        }
        await pause(PAUSE_MS);
      }
    }
  }
}

function showFleet(element: HTMLElement, zenoh: Network): void {
  const rows: [string, string][] = [
    ["Zenoh", zenoh.state === "open" ? count(zenoh.connections, "connection") : zenoh.state],
  ];
  if (zenoh.servers) {
    rows.push(["Servers", zenoh.servers.join(", ")]);
  }
  if (zenoh.locators) {
    rows.push(["Reached at", zenoh.locators.join(", ")]);
  }
  if (zenoh.why) {
    rows.push(["Trouble", zenoh.why]);
  }
  element.replaceChildren(facts(rows));
}

function showCounts(element: HTMLElement, { frames, images, rates, last_error }: Stream): void {
  const rows = [
    ["answered in budget", grouped(frames.answered - frames.answered_late)],
    ["answered late", grouped(frames.answered_late)],
    ...Object.entries(frames.dropped).map(([reason, dropped]) => [`dropped: ${inWords(reason)}`, grouped(dropped)]),
    ["lost on the way to the server", grouped(frames.lost)],
    ["results not sent: the one before was on its way", grouped(frames.unsent)],
    ...Object.entries(images.unpaired).map(([reason, unpaired]) => [`images without a pair: ${inWords(reason)}`, grouped(unpaired)]),
  ];
  const all: [string, string][] = [
    ["Frames", grouped(frames.received)],
    ["Coming in", `${rates.received_hz.toFixed(1)} Hz`],
    ["Going out", `${rates.answered_hz.toFixed(1)} Hz`],
  ];
  element.replaceChildren(facts(all), table("Frames by what became of them", ["What", "How many"], rows));
  if (last_error) {
    element.append(make("p", { class: "hint" }, `The last trouble: ${last_error}`));
  }
}

function inWords(reason: string): string {
  return reason.toLowerCase().replaceAll("_", " ");
}

function facts(rows: [string, string][]): HTMLDListElement {
  return make(
    "dl",
    { class: "facts" },
    ...rows.map(([term, fact]) => make("div", {}, make("dt", {}, term), make("dd", {}, fact))),
  );
}

function key(): HTMLElement {
  const kinds = { whole: "all rungs", fewer: "fewer rungs", late: "late", dropped: "dropped" };
  return make(
    "ul",
    { class: "key" },
    ...Object.entries(kinds).map(([kind, text]) => make("li", {}, make("i", { class: kind, "aria-hidden": "true" }), text)),
    make("li", {}, make("i", { class: "dash", "aria-hidden": "true" }), "budget"),
  );
}
