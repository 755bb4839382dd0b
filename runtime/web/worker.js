"use strict";

/** What the page's worker runs, after the functions of decoder.js and loops.js. Its text is handed to the worker. */
function gubeWorker() {
  const { readRecording, Decoder } = gubeDecoder();
  let about, arrays, decoder, normals, coarseNormals;

  /** Unit normals of a mesh, weighted by area. */
  function writeNormals(vertices, faces, out) {
    out.fill(0);
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
      const x = vertices[a], y = vertices[a + 1], z = vertices[a + 2];
      const ux = vertices[b] - x, uy = vertices[b + 1] - y, uz = vertices[b + 2] - z;
      const vx = vertices[c] - x, vy = vertices[c + 1] - y, vz = vertices[c + 2] - z;
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      out[a] += nx, out[a + 1] += ny, out[a + 2] += nz;
      out[b] += nx, out[b + 1] += ny, out[b + 2] += nz;
      out[c] += nx, out[c + 1] += ny, out[c + 2] += nz;
    }
    for (let i = 0; i < out.length; i += 3) {
      const x = out[i], y = out[i + 1], z = out[i + 2], scale = 1 / Math.max(Math.sqrt(x * x + y * y + z * z), 1e-20);
      out[i] = x * scale, out[i + 1] = y * scale, out[i + 2] = z * scale;
    }
  }

  async function load({ recording, loops }) {
    const data = await readRecording(recording);
    ({ about, arrays } = data);
    decoder = new Decoder(data, await gubeLoops(loops));
    normals = new Float32Array(decoder.fine.length);
    coarseNormals = new Float32Array(decoder.coarse.length);
    for (let k = 0; k < 10; k++) decoder.decode(k); // so that the loops are compiled well from the start
    const drawn = /^(faces|body)\/|^garments$|^frames\/(origin|matrices|places|body)$/;
    const shown = Object.entries(arrays).filter(([name]) => drawn.test(name));
    postMessage({ kind: "loaded", about, arrays: Object.fromEntries(shown) });
  }

  /** The truth at a time, about the present origin: straight between its frames, which are fewer. */
  function truthAt(time, origin) {
    const numbers = arrays["truth/numbers"], steps = arrays["frames/truth"], origins = arrays["frames/origin"];
    const after = numbers.findIndex((number) => number > time), last = numbers.length - 1;
    const j = after < 0 ? last : after, i = Math.max(after < 0 ? last : after - 1, 0);
    const share = i === j ? 0 : (time - numbers[i]) / (numbers[j] - numbers[i]), count = decoder.fine.length;
    const [scale, originScale] = ["frames/truth", "frames/origin"].map((name) => about.arrays[name].scale);
    const at = (row, k) => scale * steps[row * count + k] + originScale * origins[3 * numbers[row] + (k % 3)];
    const mixed = (_, k) => (1 - share) * at(i, k) + share * at(j, k) - origin[k % 3];
    return Float32Array.from({ length: count }, mixed);
  }

  /** Decodes a moment, given in frames, and sends copies of the results. */
  function decode(time) {
    const began = performance.now();
    decoder.decode(time);
    const decoded = performance.now();
    writeNormals(decoder.fine, arrays["faces/fine"], normals);
    writeNormals(decoder.coarse, arrays["faces/coarse"], coarseNormals);
    const costs = { decodeMs: decoded - began, normalsMs: performance.now() - decoded };
    const moment = { origin: decoder.origin.slice(), ...costs };
    const sent = { fine: decoder.fine, normals, coarse: decoder.coarse, coarseNormals };
    for (const name of Object.keys(sent)) moment[name] = Float32Array.from(sent[name]);
    if (arrays["frames/truth"]) {
      moment.truth = truthAt(time, moment.origin);
      writeNormals(moment.truth, arrays["faces/fine"], (moment.truthNormals = new Float32Array(normals.length)));
    }
    postMessage({ kind: "decoded", time, ...moment }, Object.keys(sent).map((name) => moment[name].buffer));
  }

  onmessage = async ({ data }) => {
    try {
      if (data.kind === "load") await load(data);
      else decode(data.time);
    } catch (error) {
      postMessage({ kind: "failed", message: String(error.message || error) });
    }
  };
}
