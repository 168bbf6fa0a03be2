// Camera streams, as `GET /v1/streams` and its events tell of them.

import { json, sentence } from "./api.ts";
import { events } from "./events.ts";

/** How long to wait before asking again for the events of a camera: the server has gone, or doesn't know it yet, in ms. */
const AGAIN_MS = 1000;

/** A camera's stream. */
export interface Stream {
  camera: string;
  served: boolean;
  rates: { received_hz: number; answered_hz: number };
  frames: {
    received: number;
    answered: number;
    answered_late: number;
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

/** Calls `told` for every frame of a camera until `signal` ends it; reconnects by itself. */
export async function follow(camera: string, signal: AbortSignal, told: (event: FrameEvent) => void): Promise<void> {
  while (!signal.aborted) {
    try {
      for await (const { name, data } of events(`v1/streams/${encodeURIComponent(camera)}/events`, signal)) {
        if (name === "result") {
          told({ kind: "result", report: JSON.parse(data).report });
        } else if (name === "dropped") {
          const { reason, detail } = JSON.parse(data);
          told({ kind: "dropped", reason, detail });
        }
      }
    } catch {
      // Whatever it was is told by what else asks for this camera.
    }
    await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
  }
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
  return "No camera yet: one that puts frames to stereo/v1/frames/NAME appears here by itself, such as `stereo stream FOLDER --camera NAME`.";
}
