// The wire's messages as TypeScript, generated from the descriptor set that the server's own types come from, so that there is nothing
// to go stale: protoc is not needed, its plugin gets the request that protoc would have written.

import { execFileSync } from "node:child_process";
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { create, fromBinary, toBinary } from "@bufbuild/protobuf";
import {
  CodeGeneratorRequestSchema,
  CodeGeneratorResponseSchema,
  FileDescriptorSetSchema,
} from "@bufbuild/protobuf/wkt";

const folder = join(import.meta.dirname, "..");
const descriptors = join(folder, "../../proto/src/gen/stereo.v1.binpb");

/** Writes `src/gen`. */
export function generateMessages(): void {
  const { file } = fromBinary(FileDescriptorSetSchema, readFileSync(descriptors));
  const request = create(CodeGeneratorRequestSchema, {
    fileToGenerate: file.map((each) => each.name).filter((name) => name.startsWith("stereo/")),
    parameter: "target=ts",
    protoFile: file,
  });
  const plugin = createRequire(import.meta.url).resolve("@bufbuild/protoc-gen-es/bin/protoc-gen-es");
  const written = execFileSync(process.execPath, [plugin], {
    input: toBinary(CodeGeneratorRequestSchema, request),
    maxBuffer: 1 << 26,
  });
  const response = fromBinary(CodeGeneratorResponseSchema, written);
  if (response.error) {
    throw new Error(`the messages can't be generated: ${response.error}`);
  }
  const out = join(folder, "src/gen");
  rmSync(out, { recursive: true, force: true });
  for (const { name, content } of response.file) {
    const path = join(out, name);
    mkdirSync(dirname(path), { recursive: true });
    writeFileSync(path, content);
  }
}
