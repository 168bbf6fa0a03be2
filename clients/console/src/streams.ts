// Camera streams, as `GET /v1/streams` and its events tell of them.

import { json, sentence } from "./api.ts";

/** How long to wait before asking again for the events of a camera that isn't known, in ms. */
const AGAIN_MS = 1000;

/** A camera's stream. */
export interface Stream {
  camera: string;
  served: boolean;
  rates: { received_hz: number; answered_hz: number };
  frames: {
    received: number;
    answered: number;
    dropped: Record<string, number>;
    under_way: number;
    lost: number;
    unsent: number;
  };
  images: { received: number; paired: number; unpaired: Record<string, number>; waiting: number };
  last_error: string | null;
  last_result: { sequence: number | null; report: FrameReport } | null;
}

/** The part of a report that the page shows. */
export interface FrameReport {
  budget_ms: number;
  total_ms: number;
  iterations_run: number;
  iterations_asked: number;
  rung: string;
  quality_estimate: number;
  deadline_met: boolean;
  degradation: string;
  instance: string;
}

/** The network that frames come over. */
export interface Network {
  state: "off" | "opening" | "open";
  why?: string;
  locators?: string[];
  connections: number;
  servers?: string[];
}

/** What `GET /v1/streams` says. */
export interface Streams {
  streams: Stream[];
  zenoh: Network;
}

/** All streams. */
export function streams(signal: AbortSignal): Promise<Streams> {
  return json<Streams>("v1/streams", signal);
}

/** A frame that came, and what became of it. */
export type FrameEvent =
  | { kind: "result"; report: FrameReport }
  | { kind: "dropped"; reason: string; detail: string };

/** Calls `told` for every frame of a camera until the returned function is called; reconnects by itself. */
export function follow(camera: string, told: (event: FrameEvent) => void): () => void {
  let source: EventSource;
  let again: ReturnType<typeof setTimeout> | undefined;
  const open = () => {
    source = new EventSource(`v1/streams/${encodeURIComponent(camera)}/events`);
    source.addEventListener("result", (event) => told({ kind: "result", report: JSON.parse(event.data).report }));
    source.addEventListener("dropped", (event) => {
      const { reason, detail } = JSON.parse(event.data);
      told({ kind: "dropped", reason, detail });
    });
    source.addEventListener("error", () => {
      // A lost connection comes back by itself. A server that has just started doesn't know the camera yet, and an answer of that kind
      // is the end for the browser.
      if (source.readyState === EventSource.CLOSED) {
        again = setTimeout(open, AGAIN_MS);
      }
    });
  };
  open();
  return () => {
    clearTimeout(again);
    source.close();
  };
}

/** Why there are no streams to see; empty if there is no reason. */
export function whyNone({ streams: all, zenoh }: Streams): string {
  if (zenoh.state === "off") {
    return "This server takes no camera streams: start it without --no-zenoh to see cameras here.";
  }
  if (all.length > 0) {
    return "";
  }
  if (zenoh.state === "opening") {
    return zenoh.why ? sentence(zenoh.why) : "The Zenoh session is being opened.";
  }
  return "No camera yet: one that puts frames to stereo/v1/frames/NAME appears here by itself.";
}
