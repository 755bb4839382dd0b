"use strict";

/**
 * The long loops of decoder.js in WebAssembly, see loops.ts: the same as its `plain`, many times as fast. All is in one
 * function, so that a page can hand its text to a worker.
 */
async function gubeLoops(code, megabytes = 64) {
  const memory = new WebAssembly.Memory({ initial: 16 * megabytes });
  const { instance } = await WebAssembly.instantiate(code, { env: { memory } });
  const made = instance.exports, at = (array) => array.byteOffset;
  let end = 1024;
  const kept = (type, source) => {
    const values = typeof source === "number" ? null : source, count = values ? values.length : source;
    const array = new type(memory.buffer, end, count);
    end += 4 * Math.ceil(count / 4) * 4 + 16; // some loops read and write one number more
    if (values) array.set(values);
    return array;
  };
  let work = kept(Uint32Array, 0);
  return {
    floats: (source) => kept(Float32Array, source),
    indices: (source) => kept(Uint32Array, source),
    multiplyAdd(a, b, c, rows, inner, columns) {
      const wanted = rows * (2 * inner + 2);
      if (work.length < wanted) work = kept(Uint32Array, wanted);
      made.multiplyAdd(at(a), at(b), at(c), rows, inner, columns, at(work));
    },
    rectify: (values) => made.rectify(at(values), values.length),
    multiplySparse({ start, index, value }, source, out) {
      made.multiplySparse(at(start), at(index), at(value), at(source), at(out), start.length - 1);
    },
    readPatches({ near, far, share, corners }, grids, frames, added) {
      made.readPatches(...[near, far, share, corners, grids, frames, added].map(at), added.length / 3);
    },
    addTurned({ start, index, value }, own, frames, fine) {
      made.addTurned(...[start, index, value, own, frames, fine].map(at), fine.length / 3);
    },
  };
}

if (typeof module !== "undefined") module.exports = gubeLoops;
