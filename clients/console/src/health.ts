// Whether the server is there: asked again and again, so that the page notices when it goes and when it comes back.

import { type Info, info, Refused, Unreachable } from "./api.ts";

/** How often a server that is there is asked, in ms. */
const EVERY_MS = 2000;
/** How often one that isn't. */
const AWAY_EVERY_MS = 700;

/** Where the server stands; `locked`: it lets in nobody without a token. */
export type State =
  | { kind: "ready"; info: Info }
  | { kind: "waiting"; why: string }
  | { kind: "locked"; why: string }
  | { kind: "away" };

/** Ends the pause between two questions. */
let hurry = () => {};

/** Asks at once. */
export function askNow(): void {
  hurry();
}

/** Asks for ever; calls `changed` with every state and whether the server has just come back. */
export async function follow(changed: (state: State, isBack: boolean) => void): Promise<never> {
  let wasAway = false;
  for (;;) {
    const state = await ask();
    changed(state, wasAway && state.kind === "ready");
    wasAway = state.kind === "away" || state.kind === "locked" || (wasAway && state.kind !== "ready");
    await new Promise<void>((resolve) => {
      hurry = resolve;
      setTimeout(resolve, state.kind === "away" || state.kind === "waiting" ? AWAY_EVERY_MS : EVERY_MS);
    });
  }
}

async function ask(): Promise<State> {
  try {
    const response = await fetch("readyz", { cache: "no-store" });
    const body = await response.json();
    return response.ok ? { kind: "ready", info: await info() } : { kind: "waiting", why: body.why ?? "not ready" };
  } catch (error) {
    if (error instanceof Refused) {
      return { kind: error.status === 401 ? "locked" : "waiting", why: error.message };
    }
    return error instanceof SyntaxError
      ? { kind: "waiting", why: "what answers here is not stereod" }
      : { kind: "away" };
  }
}

/** What the page says while the server is away. */
export const AWAY = new Unreachable().message;
