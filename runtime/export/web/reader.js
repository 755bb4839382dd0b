"use strict";

/**
 * Reads the file that docs/recording-file.md describes, a Uint8Array: its header, and its arrays of whole numbers by
 * name. Point i of a row stands at 3 i.
 */
async function readRecording(bytes) {
  const text = new TextDecoder(), arrays = {};
  if (text.decode(bytes.subarray(0, 8)) !== "gube rec") throw new Error("not a recorded garment");
  const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(8, true);
  const about = JSON.parse(text.decode(bytes.subarray(12, 12 + length)));
  if (about.version !== 3) throw new Error(`a recorded garment of version ${about.version}, not 3`);
  for (const [name, { shape, offset, size, differences, links }] of Object.entries(about.arrays)) {
    const block = bytes.subarray(12 + length + offset, 12 + length + offset + size);
    const stream = new Blob([block]).stream().pipeThrough(new DecompressionStream("deflate"));
    const coded = unfolded(new Uint8Array(await new Response(stream).arrayBuffer()));
    const row = coded.length / shape[0], numbers = links ? predicted(coded, arrays[links], row) : coded;
    for (let order = 0; order < differences; order++) {
      for (let i = row; i < numbers.length; i++) numbers[i] += numbers[i - row];
    }
    arrays[name] = numbers;
  }
  return { about, arrays };
}

/** Numbers from their bytes: first the lowest byte of each; 0, 1, 2, 3, 4 stand for 0, -1, 1, -2, 2. */
function unfolded(planes) {
  const count = planes.length / 4, numbers = new Int32Array(count);
  for (let i = 0; i < count; i++) {
    const folded = planes[i] | (planes[i + count] << 8) | (planes[i + 2 * count] << 16) | (planes[i + 3 * count] << 24);
    numbers[i] = (folded >>> 1) ^ -(folded & 1);
  }
  return numbers;
}

/** Points of each row from what they differ by from the mean of two earlier ones. */
function predicted(coded, links, row) {
  const numbers = new Int32Array(coded.length);
  for (let from = 0; from < coded.length; from += row) {
    for (let k = 0; k < row; k += 3) {
      const point = from + 3 * links[k], first = from + 3 * links[k + 1], second = from + 3 * links[k + 2];
      for (let s = 0; s < 3; s++) {
        numbers[point + s] = coded[from + k + s] + ((numbers[first + s] + numbers[second + s]) >> 1);
      }
    }
  }
  return numbers;
}

if (typeof module !== "undefined") module.exports = { readRecording };
