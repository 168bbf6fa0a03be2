// Images as the server sends them to those who watch: a file, or pixels.

import { type Image, ImageEncoding } from "./gen/stereo/v1/image_pb.ts";

/** An image that can be drawn. */
export function pictureOf(image: Image): Promise<ImageBitmap> {
  const pixels = rgbaOf(image);
  return pixels
    ? createImageBitmap(new ImageData(pixels, image.width, image.height))
    : createImageBitmap(new Blob([image.data as Uint8Array<ArrayBuffer>]));
}

/** Pixels with four bytes each; nothing for a file. */
export function rgbaOf({ encoding, data, width, height }: Image): Uint8ClampedArray<ArrayBuffer> | undefined {
  const bytes = { [ImageEncoding.MONO8]: 1, [ImageEncoding.RGB8]: 3 }[encoding as number];
  if (bytes === undefined) {
    return undefined;
  }
  const pixels = new Uint8ClampedArray(4 * width * height);
  for (let i = 0, from = 0; i < pixels.length; i += 4, from += bytes) {
    pixels[i] = data[from] ?? 0;
    pixels[i + 1] = data[from + (bytes === 3 ? 1 : 0)] ?? 0;
    pixels[i + 2] = data[from + bytes - 1] ?? 0;
    pixels[i + 3] = 255;
  }
  return pixels;
}
