// Encodes all textures of a glTF file as KTX2: node ktx2.mjs uastc|etc1s INPUT OUTPUT
//
// Stands in for `gltf-transform uastc` and `etc1s`, which need the program `ktx`; the encoder is Basis Universal in
// WebAssembly. Resolved from the folder of installed packages, into which the script copies this file.

import { NodeIO } from "@gltf-transform/core";
import { ALL_EXTENSIONS } from "@gltf-transform/extensions";
import { ktx2 } from "ktx2-encoder/gltf-transform";
import sharp from "sharp";

const [codec, input, output] = process.argv.slice(2);

// Slots whose values are colours in sRGB; all others are numbers, which the file must say are linear.
const COLOR_SLOTS = /Color|emissive|^diffuseTexture|^specularGlossiness/;
const NORMAL_SLOTS = /normal/i;

// KHR_texture_basisu demands sides that are multiples of a block's four texels.
const wholeBlocks = (side) => 4 * Math.ceil(side / 4);

async function imageDecoder(bytes) {
  const { width, height } = await sharp(bytes).metadata();
  const image = sharp(bytes).toColourspace("srgb").ensureAlpha();
  const resized = image.resize(wholeBlocks(width), wholeBlocks(height), { fit: "fill" });
  const { data, info } = await resized.raw().toBuffer({ resolveWithObject: true });
  return { data: new Uint8Array(data), width: info.width, height: info.height };
}

const shared = {
  isUASTC: codec === "uastc",
  needSupercompression: codec === "uastc",
  // Both at their second lowest of effort: twice as fast as the defaults, and hardly worse
  uastcLDRQualityLevel: 1,
  compressionLevel: 1,
  generateMipmap: true,
  imageDecoder,
};
const linear = { isPerceptual: false, isSetKTX2SRGBTransferFunc: false };
const io = new NodeIO().registerExtensions(ALL_EXTENSIONS);
const document = await io.read(input);
await document.transform(
  ktx2({ ...shared, slots: COLOR_SLOTS, isPerceptual: true, isSetKTX2SRGBTransferFunc: true }),
  ktx2({ ...shared, slots: NORMAL_SLOTS, ...linear, isNormalMap: true }),
  ktx2({ ...shared, ...linear }),
);
await io.write(output, document);
