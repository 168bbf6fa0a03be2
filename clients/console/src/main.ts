// The page: which of its parts is shown, and whether the server is there.

import { sentence } from "./api.ts";
import { find, say } from "./dom.ts";
import { count } from "./format.ts";
import { hasToken, install, isOpen, knock } from "./door.ts";
import { AWAY, askNow, follow, type State } from "./health.ts";
import { LivePage } from "./live.ts";
import { TryPage } from "./try.ts";

const tryPage = new TryPage();
const livePage = new LivePage();

/** Shows the page that the address names: `#/try` or `#/live/CAMERA`. */
function route(): void {
  const [, page = "try", camera] = location.hash.split("/");
  const isLive = page === "live";
  find("#try").hidden = isLive;
  find("#live").hidden = !isLive;
  for (const link of document.querySelectorAll<HTMLAnchorElement>("nav a")) {
    if (link.dataset.page === (isLive ? "live" : "try")) {
      link.setAttribute("aria-current", "page");
    } else {
      link.removeAttribute("aria-current");
    }
  }
  document.title = isLive ? "Live - stereod" : "Try it - stereod";
  if (isLive) {
    livePage.open(camera === undefined ? undefined : decodeURIComponent(camera));
  } else {
    livePage.close();
  }
}

addEventListener("hashchange", () => {
  route();
  find("#main").focus({ preventScroll: true });
});
route();

install(askNow);

/** What keeps the page from working, and what to do. */
function trouble(state: Exclude<State, { kind: "ready" }>): string {
  switch (state.kind) {
    case "away":
      return AWAY;
    case "locked":
      return hasToken() ? state.why : "This server lets in nobody without a token: enter yours.";
    case "waiting":
      return sentence(`the server is not ready: ${state.why}`);
  }
}

let isFirst = true;
void follow((state, isBack) => {
  const server = find("#server");
  server.dataset.state = state.kind;
  const text = find("span", server);
  if (state.kind === "ready") {
    const { instance, version, simd, workers } = state.info;
    text.textContent = `${instance} ${version}, ${count(workers, "worker")}, ${simd}`;
    say(find("#banner"), "");
  } else {
    text.textContent = { away: "no server", locked: "token needed", waiting: "not ready" }[state.kind];
    say(find("#banner"), trouble(state));
  }
  if (state.kind === "locked") {
    knock(state.why);
  } else {
    isOpen();
  }
  if (state.kind === "ready" && isFirst) {
    isFirst = false;
    void tryPage.useSample();
  } else if (isBack) {
    void tryPage.reconnected();
  }
});
