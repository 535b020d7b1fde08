// What the page carries, as textures: the vertex shader looks corners up by number, so that a face keeps one normal and
// one value however many faces share its vertices, and nothing is stored three times.
const TEXTURE_WIDTH = 4096;

/** The bytes of an element's base64 text; the text is then dropped. */
function takeBytes(id) {
  const element = document.getElementById(id);
  const text = atob(element.textContent);
  element.remove();
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes.buffer;
}

/** A texture of TEXTURE_WIDTH columns with one texel of `channels` numbers after the other. */
function dataTexture(values, channels, format, type, internalFormat) {
  const n = values.length / channels;
  const rows = Math.max(1, Math.ceil(n / TEXTURE_WIDTH));
  const padded = new values.constructor(rows * TEXTURE_WIDTH * channels);
  padded.set(values);
  const texture = new THREE.DataTexture(padded, TEXTURE_WIDTH, rows, format, type);
  texture.internalFormat = internalFormat;
  texture.minFilter = texture.magFilter = THREE.NearestFilter;
  texture.unpackAlignment = 1;
  texture.needsUpdate = true;
  return texture;
}

function positionTexture(values) {
  return dataTexture(values, 3, THREE.RGBFormat, THREE.FloatType, "RGB32F");
}

/** Three corners a texel; the fourth number is empty, since three.js has no integers in threes. */
function faceTexture(corners) {
  const values = new Uint32Array((corners.length / 3) * 4);
  for (let i = 0, j = 0; i < corners.length; i += 3, j += 4) {
    values[j] = corners[i];
    values[j + 1] = corners[i + 1];
    values[j + 2] = corners[i + 2];
  }
  return dataTexture(values, 4, THREE.RGBAIntegerFormat, THREE.UnsignedIntType, "RGBA32UI");
}

function valueTexture(values) {
  return dataTexture(values, 1, THREE.RedIntegerFormat, THREE.UnsignedShortType, "R16UI");
}

/** Everything the page carries; throws where sizes do not fit what the manifest says. */
function readData() {
  const manifest = JSON.parse(document.getElementById("manifest").textContent);
  const faces = new Uint32Array(takeBytes("faces"));
  const positions = ["positions-before", "positions-after"].map((id) => new Float32Array(takeBytes(id)));
  if (faces.length !== 3 * manifest.faces || positions.some((own) => own.length !== 3 * manifest.vertices)) {
    throw new Error("the meshes in this page are damaged");
  }
  const layers = manifest.layers.map((layer) => {
    const before = valueTexture(new Uint16Array(takeBytes(`${layer.name}-before`)));
    const hasOwn = document.getElementById(`${layer.name}-after`) !== null;
    return { ...layer, before, after: hasOwn ? valueTexture(new Uint16Array(takeBytes(`${layer.name}-after`))) : before };
  });
  return { manifest, faces, positions, layers };
}
