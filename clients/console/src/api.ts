// The server, as the page talks to it.

import { fromBinary, toBinary } from "@bufbuild/protobuf";
import { type StereoRequest, StereoRequestSchema } from "./gen/stereo/v1/request_pb.ts";
import { type StereoResult, StereoResultSchema } from "./gen/stereo/v1/result_pb.ts";
import { type StreamView, StreamViewSchema } from "./gen/stereo/v1/stream_pb.ts";
import { credentials } from "./door.ts";

const PROTOBUF = "application/x-protobuf";
/** Results as protobuf; refusals for people. */
const ACCEPT = `${PROTOBUF};q=0.9, application/problem+json`;

/** What `GET /v1/info` says. */
export interface Info {
  version: string;
  instance: string;
  simd: string;
  workers: number;
  presets: { name: string; rungs: string[] }[];
}

/** The server refused: its sentence says why and what to do. */
export class Refused extends Error {
  constructor(
    message: string,
    readonly status: number,
    readonly reason: string,
  ) {
    super(message);
  }
}

/** Nobody answered. */
export class Unreachable extends Error {
  constructor() {
    super("The server doesn't answer: start it again with `stereod serve`, this page reconnects by itself.");
  }
}

/** A result and what the browser saw of it. */
export interface Answer {
  result: StereoResult;
  /** From sending to having read all, in ms. */
  roundTripMs: number;
}

/** Sends a pair. */
export async function match(request: StereoRequest, signal: AbortSignal): Promise<Answer> {
  const body = toBinary(StereoRequestSchema, request) as Uint8Array<ArrayBuffer>;
  const start = performance.now();
  const headers = { "Content-Type": PROTOBUF, Accept: ACCEPT };
  const response = await ask("v1/stereo", { method: "POST", headers, body, signal });
  const bytes = await read(response);
  return { result: fromBinary(StereoResultSchema, bytes), roundTripMs: performance.now() - start };
}

/** What the server is and can. */
export async function info(): Promise<Info> {
  return (await ask("v1/info", {})).json() as Promise<Info>;
}

/** The body of a JSON route. */
export async function json<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await ask(path, signal ? { signal } : {})).json() as Promise<T>;
}

/** The next frame of a camera, with everything there is to see of it. */
export async function latest(camera: string, signal: AbortSignal): Promise<StreamView> {
  const path = `v1/streams/${encodeURIComponent(camera)}/latest?view=frame`;
  return fromBinary(StreamViewSchema, await read(await ask(path, { headers: { Accept: ACCEPT }, signal })));
}

/** A body, whole or refused. */
async function read(response: Response): Promise<Uint8Array> {
  try {
    return new Uint8Array(await response.arrayBuffer());
  } catch (error) {
    throw unreachable(error);
  }
}

/** A good response, or why there is none. */
export async function ask(path: string, init: RequestInit): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(path, { ...init, headers: { ...init.headers, ...credentials() } });
  } catch (error) {
    throw unreachable(error);
  }
  if (response.ok) {
    return response;
  }
  const problem = await response.json().catch(() => ({}));
  throw new Refused(
    sentence(problem.detail ?? `the server answered with ${response.status} ${response.statusText}`),
    response.status,
    problem.reason ?? "",
  );
}

function unreachable(error: unknown): unknown {
  return error instanceof DOMException && error.name === "AbortError" ? error : new Unreachable();
}

/** With a capital and a full stop. */
export function sentence(text: string): string {
  const whole = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}
