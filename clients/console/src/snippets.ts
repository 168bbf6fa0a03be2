// What was just done, as commands to copy.

import { type Choice, whole } from "./pair.ts";

/** What a snippet is about. */
export interface Done {
  /** The server's address: `http://host:8080`. */
  server: string;
  left: string;
  right: string;
  /** Whether the files are the server's own sample. */
  isSample: boolean;
  size: { width: number; height: number };
  /** Whether the server asks for a token; the snippets take it from the variable that the command line has for it. */
  needsToken: boolean;
  choice: Choice;
}

/** The same request with curl. */
export function asCurl(done: Done): string {
  const { choice, size } = done;
  const options: Record<string, unknown> = {
    latency_budget_ms: choice.budgetMs,
    preset: choice.preset,
    density: choice.density,
  };
  if (choice.minConfidence > 0) {
    options.min_confidence = choice.minConfidence;
  }
  if (choice.calibration) {
    const { focalPx, baselineM, cxPx, cyPx, doffsPx } = whole(choice.calibration, size);
    options.calibration = { focal_px: focalPx, cx_px: cxPx, cy_px: cyPx, baseline_m: baselineM, doffs_px: doffsPx };
  }
  return [
    ...fetched(done),
    `curl -s -F left=@${shell(done.left)} -F right=@${shell(done.right)} \\`,
    `     -F ${shell(`options=${JSON.stringify(options)}`)} \\`,
    ...(done.needsToken ? ['     -H "Authorization: Bearer $STEREO_TOKEN" \\'] : []),
    `     -H 'Accept: image/png' ${shell(`${done.server}/v1/stereo?view=color`)} -o disparity_color.png`,
  ].join("\n");
}

/** The same request in Python. */
export function asPython(done: Done): string {
  const { choice, size } = done;
  const named = [`budget_ms=${choice.budgetMs}`, `preset="${choice.preset}"`, `density="${choice.density}"`];
  if (choice.minConfidence > 0) {
    named.push(`min_confidence=${choice.minConfidence}`);
  }
  const imports = ["Client"];
  let calibration = "";
  if (choice.calibration) {
    const { focalPx, baselineM, cxPx, cyPx, doffsPx } = whole(choice.calibration, size);
    imports.unshift("Calibration");
    calibration = `calibration = Calibration(focal_px=${focalPx}, cx_px=${cxPx}, cy_px=${cyPx}, baseline_m=${baselineM}, doffs_px=${doffsPx})\n`;
    named.push("calibration=calibration");
  }
  const token = done.needsToken ? ', token=environ["STEREO_TOKEN"]' : "";
  return `${done.needsToken ? "from os import environ\n\n" : ""}from stereo_client import ${imports.join(", ")}

${calibration}with Client(${python(done.server)}${token}) as client:
    result = client.match(
        ${python(done.left)},
        ${python(done.right)},
        ${named.join(", ")},
    )
print(result.report)
result.save("disparity_color.png", "color")`;
}

/** Commands that get the sample's files. */
function fetched({ isSample, server, left, right }: Done): string[] {
  return isSample ? [`curl -s -O ${shell(`${server}/sample/${left}`)} -O ${shell(`${server}/sample/${right}`)}`] : [];
}

/** A text as one word of a shell. */
export function shell(text: string): string {
  return /^[\w./:@=-]+$/.test(text) ? text : `'${text.replaceAll("'", `'\\''`)}'`;
}

/** A text as a literal of Python. */
export function python(text: string): string {
  return `"${text.replaceAll("\\", "\\\\").replaceAll('"', '\\"')}"`;
}
