import { join } from "node:path";
import { defineConfig } from "vitest/config";
import { compressFiles, emptyFolder } from "./build/bundle.ts";
import { generateMessages } from "./build/messages.ts";

const dist = join(import.meta.dirname, "dist");

generateMessages();

export default defineConfig({
  base: "./",
  build: {
    target: "es2022",
    emptyOutDir: false,
    // A data: URL would be one more thing for the content security policy to allow.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 800,
  },
  plugins: [
    {
      name: "dist",
      apply: "build",
      buildStart: () => emptyFolder(dist),
      closeBundle: () => compressFiles(dist),
    },
  ],
  // `npm run dev` talks to a server on the usual port.
  server: { proxy: Object.fromEntries(["/v1", "/readyz"].map((path) => [path, "http://127.0.0.1:8080"])) },
  test: {
    include: ["tests/**/*.test.ts"],
    // One browser and one server at a time: the machine is shared.
    fileParallelism: false,
    testTimeout: 60_000,
    hookTimeout: 120_000,
  },
});
