// The four views of a frame: left image, disparity, confidence and mesh.

import { CONFIDENCE_PALETTE, PALETTES, type Scheme } from "./color.ts";
import { find, make, say } from "./dom.ts";
import { grouped, percent } from "./format.ts";
import type { StereoResult } from "./gen/stereo/v1/result_pb.ts";
import { confidenceLegend, disparityLegend } from "./legend.ts";
import { depthM, FIXED_PER_PX, type Maps, paintConfidence, paintDisparity, type Range, rangeOf, readMaps } from "./maps.ts";
import { type Look, MeshView } from "./scene.ts";

type Part = "left" | "disparity" | "confidence" | "mesh";
const PARTS: Part[] = ["left", "disparity", "confidence", "mesh"];
const SCHEME_KEY = "stereod.scheme";

/** The four panels, filled with one frame after the other. */
export class Views {
  readonly #root: HTMLElement;
  readonly #panels: Record<Part, HTMLElement>;
  readonly #canvases: Record<Part, HTMLCanvasElement>;
  readonly #probe: HTMLElement;
  readonly #scheme: HTMLSelectElement;
  #mesh: MeshView | undefined;
  #shown: { maps: Maps; range: Range; result: StereoResult } | undefined;
  #hasLeft = false;

  /** Panels in the place that `place` finds. */
  constructor(place: string) {
    const template = find<HTMLTemplateElement>("#views");
    this.#root = find(place);
    this.#root.append(template.content.cloneNode(true));
    const each = <T>(get: (part: Part) => T) =>
      Object.fromEntries(PARTS.map((part) => [part, get(part)])) as Record<Part, T>;
    this.#panels = each((part) => find(`[data-part=${part}]`, this.#root));
    this.#canvases = each((part) => find<HTMLCanvasElement>("canvas", this.#panels[part]));
    this.#probe = find("[data-role=probe]", this.#root);
    this.#scheme = find<HTMLSelectElement>("[data-role=scheme]", this.#root);
    this.#scheme.value = localStorage.getItem(SCHEME_KEY) === "viridis" ? "viridis" : "turbo";
    this.#scheme.addEventListener("change", () => {
      localStorage.setItem(SCHEME_KEY, this.#scheme.value);
      this.#paint();
    });
    find("[data-role=reset]", this.#root).addEventListener("click", () => this.#mesh?.reset());
    const look = find<HTMLSelectElement>("[data-role=look]", this.#root);
    look.addEventListener("change", () => this.#mesh?.setLook(look.value as Look));
    for (const part of ["left", "disparity", "confidence"] as const) {
      this.#canvases[part].addEventListener("pointermove", (event) => this.#read(event));
      this.#canvases[part].addEventListener("pointerleave", () => say(this.#probe, ""));
    }
    this.clear("");
  }

  /** Empties all panels, saying why. */
  clear(why: string): void {
    for (const part of PARTS) {
      this.#empty(part, part === "left" ? why : "");
    }
    this.#shown = undefined;
    this.#hasLeft = false;
    this.#mesh?.clear();
  }

  /** Shows a left image before there is a result for it. */
  showLeft(left: ImageBitmap): void {
    const canvas = this.#canvases.left;
    canvas.width = left.width;
    canvas.height = left.height;
    canvas.getContext("2d")?.drawImage(left, 0, 0);
    this.#hasLeft = true;
    this.#fill("left", `${left.width} x ${left.height} px`);
  }

  /** Shows a result; its left image has been shown before, if there is one. */
  show(result: StereoResult): void {
    if (result.disparity) {
      const maps = readMaps(result.disparity);
      this.#shown = { maps, range: rangeOf(maps.disparity), result };
      this.#paint();
    }
  }

  #paint(): void {
    if (!this.#shown) {
      return;
    }
    const { maps, range, result } = this.#shown;
    const palette = PALETTES[this.#scheme.value as Scheme];
    paintDisparity(this.#canvases.disparity, maps, range, palette);
    this.#fill("disparity");
    disparityLegend(this.#legend("disparity"), palette, range, maps.calibration);
    const share = percent(result.report?.density ?? 0);
    this.#canvases.disparity.setAttribute("aria-label", `Disparity of ${share} of the pixels asked for`);
    paintConfidence(this.#canvases.confidence, maps, CONFIDENCE_PALETTE);
    this.#fill("confidence");
    confidenceLegend(this.#legend("confidence"), CONFIDENCE_PALETTE);
    const mesh = result.mesh;
    if (!mesh || mesh.indices.length === 0) {
      this.#mesh?.clear();
      this.#empty("mesh", mesh ? "No triangle was kept." : "This frame has no mesh.");
      return;
    }
    try {
      this.#mesh ??= new MeshView(this.#canvases.mesh);
    } catch {
      this.#empty("mesh", "This browser has no WebGL: switch it on, or take another one to see the mesh.");
      return;
    }
    const setting = { ...maps, range, palette };
    const note = this.#mesh.show(mesh, setting, this.#hasLeft ? this.#canvases.left : undefined);
    this.#fill("mesh");
    find("[data-role=triangles]", this.#panels.mesh).textContent =
      `${grouped(mesh.indices.length / 12)} triangles, ${grouped(mesh.positions.length / 12)} vertices, ${note}`;
  }

  #legend(part: Part): HTMLElement {
    return find("[data-role=legend]", this.#panels[part]);
  }

  #fill(part: Part, foot?: string): void {
    this.#panels[part].dataset.state = "full";
    if (foot) {
      find(".foot", this.#panels[part]).textContent = foot;
    }
  }

  #empty(part: Part, why: string): void {
    this.#panels[part].dataset.state = "empty";
    find(".empty", this.#panels[part]).textContent = why;
    find(".foot", this.#panels[part]).replaceChildren();
  }

  /** What is under the pointer. */
  #read(event: PointerEvent): void {
    const canvas = event.currentTarget as HTMLCanvasElement;
    if (!this.#shown) {
      return;
    }
    const { maps } = this.#shown;
    const box = canvas.getBoundingClientRect();
    const x = Math.floor(((event.clientX - box.left) / box.width) * maps.width);
    const y = Math.floor(((event.clientY - box.top) / box.height) * maps.height);
    const fixed = maps.disparity[y * maps.width + x] ?? 0;
    const facts = [`${x}, ${y}`];
    if (fixed === 0) {
      facts.push("no disparity");
    } else {
      const px = fixed / FIXED_PER_PX;
      facts.push(`${px.toFixed(2)} px`);
      if (maps.calibration) {
        facts.push(`${depthM(px, maps.calibration).toFixed(2)} m`);
      }
      facts.push(`confidence ${percent((maps.confidence[y * maps.width + x] ?? 0) / 254)}`);
    }
    this.#probe.replaceChildren(...facts.map((fact) => make("span", {}, fact)));
    this.#probe.hidden = false;
    const place = this.#root.getBoundingClientRect();
    this.#probe.style.transform = `translate(${event.clientX - place.left + 14}px, ${event.clientY - place.top + 14}px)`;
  }
}
