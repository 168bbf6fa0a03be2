// Who the user is to the server: a token, which is asked for when the server wants one. It is kept until the tab is closed.

import { find, say } from "./dom.ts";

const KEY = "stereod-token";

/** What was entered in this tab; a browser that keeps nothing forgets it when the page is loaded anew. */
let token = kept()?.getItem(KEY) ?? "";
/** Whether the user has said that there is no token for now. */
let isPutOff = false;

function kept(): Storage | undefined {
  try {
    return globalThis.sessionStorage;
  } catch {
    return undefined;
  }
}

/** Whether there is one. */
export function hasToken(): boolean {
  return token !== "";
}

/** What every request has to show. */
export function credentials(): Record<string, string> {
  return token === "" ? {} : { Authorization: `Bearer ${token}` };
}

const dialog = () => find<HTMLDialogElement>("#door");
const input = () => find<HTMLInputElement>("#token");

/** The server lets nobody in with what was shown: asks for another token, unless the user has put that off. */
export function knock(why: string): void {
  find("#enter").hidden = false;
  if (!isPutOff && !dialog().open) {
    // The first time, that a token is wanted is all there is to say.
    say(find("#door-problem"), hasToken() ? why : "");
    dialog().showModal();
    input().focus();
  }
}

/** It lets everybody in, or this user. */
export function isOpen(): void {
  find("#enter").hidden = true;
  isPutOff = false;
  if (dialog().open) {
    dialog().close();
  }
}

/** Makes dialog and button work; calls `entered` when there is a token to be tried. */
export function install(entered: () => void): void {
  find("#enter").addEventListener("click", () => {
    isPutOff = false;
    say(find("#door-problem"), "");
    dialog().showModal();
    input().focus();
  });
  dialog().addEventListener("cancel", () => {
    isPutOff = true;
  });
  find("#door-later").addEventListener("click", () => {
    isPutOff = true;
    dialog().close();
  });
  find("#door form").addEventListener("submit", (event) => {
    event.preventDefault();
    token = input().value.trim();
    input().value = "";
    kept()?.setItem(KEY, token);
    dialog().close();
    entered();
  });
}
