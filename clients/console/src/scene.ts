// The mesh in 3D: textured with the left image, turned with the mouse, fingers or keys.

import {
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  DoubleSide,
  Mesh,
  MeshBasicMaterial,
  PerspectiveCamera,
  Scene,
  SRGBColorSpace,
  Spherical,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { type Palette, place } from "./color.ts";
import type { Calibration } from "./gen/stereo/v1/calibration_pb.ts";
import { type Mesh as SentMesh, MeshSpace } from "./gen/stereo/v1/mesh_pb.ts";
import type { Range } from "./maps.ts";

/** How the surface is shown. */
export type Look = "image" | "disparity" | "wires";

/** What the mesh belongs to. */
export interface Setting {
  width: number;
  height: number;
  calibration: Calibration | undefined;
  range: Range;
  palette: Palette;
}

/** An angle that one press of a key turns by. */
const KEY_TURN = Math.PI / 36;
const KEY_ZOOM = 1.1;
/** Where the viewer stands at first, seen from the camera's own place: a little aside, so that depth shows. */
const ASIDE = { right: -0.28, up: 0.16, back: 0.12 };

/** A canvas with the mesh in it; draws only when something has changed. */
export class MeshView {
  readonly #renderer: WebGLRenderer;
  readonly #scene = new Scene();
  readonly #camera = new PerspectiveCamera(50, 1, 0.01, 1000);
  readonly #controls: OrbitControls;
  readonly #geometry = new BufferGeometry();
  readonly #material = new MeshBasicMaterial({ side: DoubleSide });
  readonly #canvas: HTMLCanvasElement;
  #texture: CanvasTexture | undefined;
  #look: Look = "image";
  #home: { focus: number; key: string } | undefined;
  #isScheduled = false;

  constructor(canvas: HTMLCanvasElement) {
    this.#canvas = canvas;
    this.#renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.#scene.add(new Mesh(this.#geometry, this.#material));
    this.#controls = new OrbitControls(this.#camera, canvas);
    this.#controls.addEventListener("change", () => this.#schedule());
    canvas.addEventListener("keydown", (event) => this.#press(event));
    new ResizeObserver(() => this.#schedule()).observe(canvas.parentElement ?? canvas);
  }

  /** Shows a mesh as it was sent. `left` is its texture, if there is one. Returns what there is to say about it. */
  show(sent: SentMesh, setting: Setting, left: HTMLCanvasElement | undefined): string {
    const positions = place3d(floats(sent.positions), sent.space, setting);
    const disparities = floats(sent.disparities);
    const colors = new Float32Array(3 * disparities.length);
    disparities.forEach((px, i) => {
      const at = 4 * place(px, setting.range.from, setting.range.to);
      for (let k = 0; k < 3; k++) {
        // The renderer works on linear light.
        colors[3 * i + k] = ((setting.palette[at + k] ?? 0) / 255) ** 2.2;
      }
    });
    this.#geometry.setAttribute("position", new BufferAttribute(positions, 3));
    this.#geometry.setAttribute("uv", new BufferAttribute(floats(sent.uvs), 2));
    this.#geometry.setAttribute("color", new BufferAttribute(colors, 3));
    this.#geometry.setIndex(new BufferAttribute(integers(sent.indices), 1));
    this.#geometry.computeBoundingSphere();
    if (left) {
      this.#retexture(left);
    }
    this.#dress();
    const key = `${setting.width}x${setting.height} ${sent.space} ${setting.calibration?.focalPx ?? 0}`;
    if (this.#home?.key !== key) {
      const focal = focalPx(setting);
      this.#camera.fov = (2 * Math.atan(setting.height / (2 * focal)) * 180) / Math.PI;
      this.#home = { focus: middle(positions), key };
      this.reset();
    }
    this.#schedule();
    return sent.space === MeshSpace.METRES ? "in metres" : "proportions guessed: give a calibration for metres";
  }

  /** Nothing to see. */
  clear(): void {
    this.#geometry.setIndex(new BufferAttribute(new Uint32Array(0), 1));
    this.#home = undefined;
    this.#schedule();
  }

  /** How the surface is shown from now on. */
  setLook(look: Look): void {
    this.#look = look;
    this.#dress();
    this.#schedule();
  }

  /** Back to the first view: the camera's own, from a little aside. */
  reset(): void {
    const focus = this.#home?.focus ?? 1;
    this.#controls.target.set(0, 0, -focus);
    this.#camera.position.set(ASIDE.right * focus, ASIDE.up * focus, ASIDE.back * focus);
    this.#camera.near = focus / 200;
    this.#camera.far = focus * 200;
    this.#controls.update();
    this.#schedule();
  }

  #retexture(left: HTMLCanvasElement): void {
    this.#texture?.dispose();
    this.#texture = new CanvasTexture(left);
    this.#texture.colorSpace = SRGBColorSpace;
    // The mesh counts from the image's top.
    this.#texture.flipY = false;
    this.#texture.anisotropy = 4;
  }

  #dress(): void {
    const isImage = this.#look === "image" && this.#texture !== undefined;
    this.#material.map = isImage ? (this.#texture ?? null) : null;
    this.#material.vertexColors = !isImage;
    this.#material.wireframe = this.#look === "wires";
    this.#material.needsUpdate = true;
  }

  #press(event: KeyboardEvent): void {
    const turn: Record<string, [number, number]> = {
      ArrowLeft: [-KEY_TURN, 0],
      ArrowRight: [KEY_TURN, 0],
      ArrowUp: [0, -KEY_TURN],
      ArrowDown: [0, KEY_TURN],
    };
    const zoom: Record<string, number> = { "+": 1 / KEY_ZOOM, "=": 1 / KEY_ZOOM, "-": KEY_ZOOM };
    if (event.key === "0") {
      this.reset();
    } else if (turn[event.key] || zoom[event.key]) {
      const [theta, phi] = turn[event.key] ?? [0, 0];
      const arm = new Vector3().subVectors(this.#camera.position, this.#controls.target);
      const at = new Spherical().setFromVector3(arm);
      at.theta += theta;
      at.phi += phi;
      at.radius *= zoom[event.key] ?? 1;
      this.#camera.position.setFromSpherical(at.makeSafe()).add(this.#controls.target);
      this.#controls.update();
    } else {
      return;
    }
    event.preventDefault();
  }

  #schedule(): void {
    if (!this.#isScheduled) {
      this.#isScheduled = true;
      requestAnimationFrame(() => {
        this.#isScheduled = false;
        this.#draw();
      });
    }
  }

  #draw(): void {
    const { clientWidth, clientHeight } = this.#canvas;
    if (clientWidth === 0 || clientHeight === 0) {
      return;
    }
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.#renderer.setSize(clientWidth, clientHeight, false);
    this.#camera.aspect = clientWidth / clientHeight;
    this.#camera.updateProjectionMatrix();
    this.#renderer.render(this.#scene, this.#camera);
  }
}

function focalPx({ calibration, width }: Setting): number {
  // Without a calibration, a usual lens.
  return calibration?.focalPx ?? width;
}

/** Positions with y up and the viewer looking along -z. Without metres, depth is what a usual camera would have. */
function place3d(sent: Float32Array, space: MeshSpace, setting: Setting): Float32Array {
  const placed = new Float32Array(sent.length);
  const focal = focalPx(setting);
  for (let i = 0; i + 2 < sent.length; i += 3) {
    const [x = 0, y = 0, z = 0] = sent.subarray(i, i + 3);
    if (space === MeshSpace.METRES) {
      placed.set([x, -y, -z], i);
    } else {
      const depth = setting.width / 10 / Math.max(z, 0.5);
      placed.set(
        [((x - setting.width / 2) * depth) / focal, ((setting.height / 2 - y) * depth) / focal, -depth],
        i,
      );
    }
  }
  return placed;
}

/** The middle of all depths. */
function middle(positions: Float32Array): number {
  const depths: number[] = [];
  for (let i = 2; i < positions.length; i += 3) {
    depths.push(-(positions[i] ?? 0));
  }
  depths.sort((a, b) => a - b);
  return depths[depths.length >> 1] ?? 1;
}

function floats(bytes: Uint8Array): Float32Array {
  return new Float32Array(bytes.slice().buffer);
}

function integers(bytes: Uint8Array): Uint32Array {
  return new Uint32Array(bytes.slice().buffer);
}
