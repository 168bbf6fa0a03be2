// Whether the server is there: asked again and again, so that the page notices when it goes and when it comes back.

import { type Info, info, Unreachable } from "./api.ts";

/** How often a server that is there is asked, in ms. */
const EVERY_MS = 2000;
/** How often one that isn't. */
const AWAY_EVERY_MS = 700;

/** Where the server stands. */
export type State = { kind: "ready"; info: Info } | { kind: "waiting"; why: string } | { kind: "away" };

/** Asks for ever; calls `changed` with every state and whether the server has just come back. */
export async function follow(changed: (state: State, isBack: boolean) => void): Promise<never> {
  let wasAway = false;
  for (;;) {
    const state = await ask();
    changed(state, wasAway && state.kind === "ready");
    wasAway = state.kind === "away" || (wasAway && state.kind !== "ready");
    await new Promise((resolve) => setTimeout(resolve, state.kind === "ready" ? EVERY_MS : AWAY_EVERY_MS));
  }
}

async function ask(): Promise<State> {
  try {
    const response = await fetch("readyz", { cache: "no-store" });
    const body = await response.json();
    return response.ok ? { kind: "ready", info: await info() } : { kind: "waiting", why: body.why ?? "not ready" };
  } catch (error) {
    return error instanceof SyntaxError
      ? { kind: "waiting", why: "what answers here is not stereod" }
      : { kind: "away" };
  }
}

/** What the page says while the server is away. */
export const AWAY = new Unreachable().message;
