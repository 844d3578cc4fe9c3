// Writes a twin as plain glTF, by the decoders of Draco, meshoptimizer, Basis Universal and libwebp themselves:
// node decode.mjs INPUT OUTPUT

import fs from "node:fs/promises";
import { NodeIO } from "@gltf-transform/core";
import { ALL_EXTENSIONS } from "@gltf-transform/extensions";
import { dequantize, uninstance } from "@gltf-transform/functions";
import draco3d from "draco3dgltf";
import { MeshoptDecoder } from "meshoptimizer";
import sharp from "sharp";
// Past the package's entry, which only encodes; this file lies beside `node_modules`
import loadBasis from "./node_modules/ktx2-encoder/dist/basis/basis_encoder.js";

const [input, output] = process.argv.slice(2);
const COMPRESSION = ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "EXT_texture_webp", "KHR_texture_basisu"];
// Basis Universal's number of the format of four bytes a texel
const RGBA32 = 13;

// The two extensions of meshoptimizer have the same structure, and names of the same length.
function withVendorName(bytes) {
  return Buffer.from(bytes.toString("latin1").replaceAll("KHR_meshopt_compression", "EXT_meshopt_compression"), "latin1");
}

function decodedKtx2(basis, bytes) {
  const file = new basis.KTX2File(bytes);
  const [width, height] = [file.getWidth(), file.getHeight()];
  if (!file.startTranscoding()) throw new Error("Basis Universal cannot read a texture");
  const texels = new Uint8Array(file.getImageTranscodedSizeInBytes(0, 0, 0, RGBA32));
  if (!file.transcodeImage(texels, 0, 0, 0, RGBA32, 0, -1, -1)) throw new Error("Basis Universal cannot decode a texture");
  file.delete();
  return sharp(texels, { raw: { width, height, channels: 4 } });
}

await MeshoptDecoder.ready;
const io = new NodeIO().registerExtensions(ALL_EXTENSIONS).registerDependencies({
  "draco3d.decoder": await draco3d.createDecoderModule(),
  "meshopt.decoder": MeshoptDecoder,
});
const document = await io.readBinary(withVendorName(await fs.readFile(input)));
for (const texture of document.getRoot().listTextures()) {
  const kind = texture.getMimeType();
  if (kind !== "image/webp" && kind !== "image/ktx2") continue;
  const basis = await loadBasis();
  basis.initializeBasis();
  const image = kind === "image/webp" ? sharp(texture.getImage()) : decodedKtx2(basis, texture.getImage());
  texture.setImage(await image.png().toBuffer()).setMimeType("image/png");
}
for (const extension of document.getRoot().listExtensionsUsed()) {
  if (COMPRESSION.includes(extension.extensionName)) extension.dispose();
}
await document.transform(dequantize(), uninstance());
await io.write(output, document);
