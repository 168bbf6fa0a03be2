// What surrounds the bundle: an empty folder before it, compressed copies of its larger files after it.

import { readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

/** Files below this size are sent as they are. */
const WORTH_COMPRESSING_BYTES = 1024;

/** Empties a folder but for its `.gitignore`: the folder itself is part of the sources. */
export function emptyFolder(folder: string): void {
  for (const name of readdirSync(folder).filter((each) => each !== ".gitignore")) {
    rmSync(join(folder, name), { recursive: true });
  }
}

/** Puts `x.gz` beside every text file `x` of a folder and those below. */
export function compressFiles(folder: string): void {
  for (const entry of readdirSync(folder, { withFileTypes: true, recursive: true })) {
    const path = join(entry.parentPath, entry.name);
    if (entry.isFile() && /\.(html|js|css|svg)$/.test(entry.name)) {
      const bytes = readFileSync(path);
      if (bytes.length >= WORTH_COMPRESSING_BYTES) {
        writeFileSync(`${path}.gz`, gzipSync(bytes, { level: 9 }));
      }
    }
  }
}
