// Server-sent events over fetch: what browsers have for them can't show a token.

import { ask } from "./api.ts";

/** One event. */
export interface ServerEvent {
  name: string;
  data: string;
}

/** The events of a route, until the server or `signal` ends them. */
export async function* events(path: string, signal: AbortSignal): AsyncGenerator<ServerEvent> {
  const response = await ask(path, { headers: { Accept: "text/event-stream" }, cache: "no-store", signal });
  if (!response.body) {
    return;
  }
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let arrived = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) {
      return;
    }
    arrived += value;
    const blocks = arrived.split(/\r?\n\r?\n/);
    arrived = blocks.pop() ?? "";
    yield* blocks.map(parse).filter((event) => event.data !== "");
  }
}

/** The lines of one event; comments, which keep connections alive, have no data. */
export function parse(block: string): ServerEvent {
  let name = "message";
  const data: string[] = [];
  for (const line of block.split(/\r?\n/)) {
    const [, field, value = ""] = /^(\w+): ?(.*)$/.exec(line) ?? [];
    if (field === "event") {
      name = value;
    } else if (field === "data") {
      data.push(value);
    }
  }
  return { name, data: data.join("\n") };
}
