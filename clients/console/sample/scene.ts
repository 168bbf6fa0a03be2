// A still life, seen by two cameras side by side. All of it is computed: shapes, textures and light.

import * as three from "three";

const SIZE = { width: 640, height: 480 };
/** Pixels that become one, in each direction. */
const SUPERSAMPLING = 3;

export const CALIBRATION = {
  focalPx: 560,
  baselineM: 0.16,
  cxPx: (SIZE.width - 1) / 2,
  cyPx: (SIZE.height - 1) / 2,
  doffsPx: 0,
};

/** Numbers from 0 to 1 that are the same every time (mulberry32). */
function random(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

/** A cloudy texture around a colour: noise of several sizes, stretched by `grain` along one side. */
function texture(seed: number, color: string, contrast: number, grain = 1, repeat = 1): three.CanvasTexture {
  const side = 1024;
  const noise = new Float32Array(side * side);
  for (let cells = 8, strength = 1; cells <= 256; cells *= 2, strength *= 0.78) {
    const dice = random(seed * 7919 + cells);
    const [columns, rows] = [cells, Math.max(1, Math.round(cells / grain))];
    const lattice = Float32Array.from({ length: columns * rows }, dice);
    const smooth = (t: number) => t * t * (3 - 2 * t);
    for (let y = 0; y < side; y++) {
      const v = (y / side) * rows;
      const [y0, ty] = [Math.floor(v), smooth(v % 1)];
      for (let x = 0; x < side; x++) {
        const u = (x / side) * columns;
        const [x0, tx] = [Math.floor(u), smooth(u % 1)];
        const at = (i: number, j: number) => lattice[((y0 + j) % rows) * columns + ((x0 + i) % columns)] ?? 0;
        const upper = at(0, 0) * (1 - tx) + at(1, 0) * tx;
        const lower = at(0, 1) * (1 - tx) + at(1, 1) * tx;
        noise[y * side + x]! += strength * (upper * (1 - ty) + lower * ty - 0.5);
      }
    }
  }
  const canvas = document.createElement("canvas");
  canvas.width = side;
  canvas.height = side;
  const context = canvas.getContext("2d")!;
  const image = context.createImageData(side, side);
  const base = new three.Color(color).convertLinearToSRGB();
  for (let i = 0; i < noise.length; i++) {
    const light = 1 + contrast * noise[i]!;
    image.data.set([base.r, base.g, base.b].map((part) => 255 * part * light).concat(255), 4 * i);
  }
  context.putImageData(image, 0, 0);
  const map = new three.CanvasTexture(canvas);
  map.colorSpace = three.SRGBColorSpace;
  map.wrapS = map.wrapT = three.RepeatWrapping;
  map.repeat.set(repeat, repeat);
  map.anisotropy = 16;
  return map;
}

function still(): three.Scene {
  const scene = new three.Scene();
  const add = (shape: three.BufferGeometry, map: three.Texture, at: [number, number, number], turn: [number, number, number] = [0, 0, 0]) => {
    const solid = new three.Mesh(shape, new three.MeshLambertMaterial({ map }));
    solid.position.set(...at);
    solid.rotation.set(...turn);
    solid.castShadow = true;
    solid.receiveShadow = true;
    scene.add(solid);
  };
  const wood = texture(1, "#b98b5e", 0.7, 8, 4);
  const wall = texture(2, "#8fa7ad", 0.42, 1, 4);
  // Metres; y up, looking along -z; the table's top is half a metre below the cameras.
  add(new three.PlaneGeometry(7, 5), wood, [0, -0.5, -2.4], [-Math.PI / 2, 0, 0.12]);
  add(new three.PlaneGeometry(9, 5), wall, [0, 1, -3.7], [0, 0.16, 0]);
  add(new three.BoxGeometry(0.5, 0.72, 0.32), texture(3, "#a6524a", 0.7), [-0.72, -0.14, -2.15], [0, 0.55, 0]);
  add(new three.BoxGeometry(0.62, 0.16, 0.44), texture(4, "#d9c79a", 0.5), [0.06, -0.42, -1.75], [0, -0.3, 0]);
  add(new three.BoxGeometry(0.5, 0.12, 0.36), texture(5, "#3f6f7d", 0.9), [0.04, -0.28, -1.77], [0, 0.12, 0]);
  add(new three.SphereGeometry(0.2, 96, 64), texture(6, "#d8923c", 0.6, 1, 1), [0.06, -0.02, -1.78], [0.4, 0.6, 0]);
  add(new three.CylinderGeometry(0.13, 0.13, 0.66, 96), texture(7, "#74884f", 0.75), [0.72, -0.17, -2.5]);
  add(new three.TorusKnotGeometry(0.19, 0.065, 300, 48), texture(8, "#c9b8c9", 0.6, 1, 2), [0.6, -0.18, -1.62], [0.5, 0.4, 0]);
  add(new three.ConeGeometry(0.19, 0.52, 96), texture(9, "#7b6ba0", 0.7), [-0.42, -0.24, -1.5], [0, 0.9, 0]);
  add(new three.BoxGeometry(0.34, 1.5, 0.3), texture(10, "#6c7480", 0.8), [1.3, 0.25, -3], [0, 0.4, 0]);
  add(new three.SphereGeometry(0.11, 96, 64), texture(11, "#b8bf8a", 0.6), [-0.1, -0.39, -1.22], [1, 0, 0]);
  scene.add(new three.HemisphereLight("#f4f6ff", "#8a7a66", 1.9));
  const lamp = new three.DirectionalLight("#fff1dc", 2.1);
  lamp.position.set(-2.2, 3, 0.6);
  lamp.target.position.set(0.2, -0.4, -2.2);
  lamp.castShadow = true;
  lamp.shadow.mapSize.set(2048, 2048);
  lamp.shadow.radius = 5;
  lamp.shadow.bias = -0.0005;
  lamp.shadow.normalBias = 0.01;
  Object.assign(lamp.shadow.camera, { left: -3, right: 3, top: 3, bottom: -3, near: 0.5, far: 9 });
  scene.add(lamp, lamp.target);
  return scene;
}

/** Both views as JPEG data URLs. */
function render(): string[] {
  const renderer = new three.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setSize(SIZE.width * SUPERSAMPLING, SIZE.height * SUPERSAMPLING, false);
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = three.VSMShadowMap;
  const scene = still();
  const fov = (2 * Math.atan(SIZE.height / (2 * CALIBRATION.focalPx)) * 180) / Math.PI;
  return [0, CALIBRATION.baselineM].map((x) => {
    const camera = new three.PerspectiveCamera(fov, SIZE.width / SIZE.height, 0.1, 20);
    camera.position.x = x;
    renderer.render(scene, camera);
    const small = document.createElement("canvas");
    small.width = SIZE.width;
    small.height = SIZE.height;
    const context = small.getContext("2d")!;
    context.imageSmoothingQuality = "high";
    context.drawImage(renderer.domElement, 0, 0, SIZE.width, SIZE.height);
    return small.toDataURL("image/jpeg", 0.93);
  });
}

Object.assign(window, { sample: { render, calibration: CALIBRATION } });
