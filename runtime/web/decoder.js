"use strict";

// Reads the file that docs/recording-file.md describes and decodes its frames. Lengths are in metres; vector i of an
// array stands at 3 i. All is in one function, so that a page can hand its text to a worker.
function gubeDecoder() {
  const TYPES = { int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array, int32: Int32Array,
    uint32: Uint32Array, float32: Float32Array };
  const POINTS = 25, CENTRE = 12, UP = 17, DOWN = 7, LEFT = 11, RIGHT = 13; // of a stencil
  const INNER = [6, 7, 8, 11, 12, 13, 16, 17, 18];

  /** Header and arrays of a file, a Uint8Array. Arrays of frames stay whole numbers, the others get their values. */
  async function readRecording(bytes) {
    const text = new TextDecoder();
    if (text.decode(bytes.subarray(0, 8)) !== "gube rec") throw new Error("not a recorded garment");
    const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(8, true);
    const about = JSON.parse(text.decode(bytes.subarray(12, 12 + length)));
    if (about.version !== 2) throw new Error(`a recorded garment of version ${about.version}, not 2`);
    const steps = {}, arrays = {};
    for (const [name, entry] of Object.entries(about.arrays)) {
      const start = 12 + length + entry.offset;
      steps[name] = await unpacked(bytes.subarray(start, start + entry.size), entry);
      arrays[name] = name.startsWith("frames/") ? steps[name] : scaled(steps[name], entry, steps);
    }
    return { about, arrays };
  }

  /** The numbers of an array: decompressed, bytes put together, differences summed up. */
  async function unpacked(block, entry) {
    const stream = new Blob([block]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const type = TYPES[entry.type], width = type.BYTES_PER_ELEMENT, count = planes.length / width;
    const bytes = new Uint8Array(planes.length);
    for (let b = 0; b < width; b++) for (let i = 0; i < count; i++) bytes[i * width + b] = planes[b * count + i];
    const values = new type(bytes.buffer), row = count / entry.shape[0];
    for (let order = 0; order < (entry.differences || 0); order++) {
      for (let i = row; i < count; i++) values[i] += values[i - row]; // wraps around
    }
    return values;
  }

  /** Whole numbers times one scale, or times the scale of their line along an axis. */
  function scaled(steps, { scale, along, shape }, all) {
    if (scale === undefined) return steps;
    if (typeof scale === "number") return Float32Array.from(steps, (step) => step * scale);
    const inner = shape.slice(along + 1).reduce((a, b) => a * b, 1), line = shape[along] * inner;
    return Float32Array.from(steps, (step, i) => step * all[scale][Math.floor(i / line) * inner + (i % inner)]);
  }

  /** The long loops. Another object that does the same faster may stand in for this one. */
  const plain = {
    floats: (source) => new Float32Array(source), // a number of zeros, or numbers
    indices: (source) => new Uint32Array(source),
    rectify: (values) => values.forEach((value, i) => (values[i] = Math.max(value, 0))),
    /** c += a b, row after row; a has `inner` columns, b and c have `columns`. */
    multiplyAdd(a, b, c, rows, inner, columns) {
      for (let i = 0; i < rows * inner; i++) {
        const factor = a[i], to = Math.floor(i / inner) * columns, from = (i % inner) * columns;
        if (factor !== 0) for (let j = 0; j < columns; j++) c[to + j] += factor * b[from + j];
      }
    },
    /** A sparse matrix times vectors: out[i] = sum of value[q] source[index[q]] over start[i] <= q < start[i + 1]. */
    multiplySparse({ start, index, value }, source, out) {
      out.fill(0);
      for (let i = 0; i < out.length; i++) {
        const row = Math.floor(i / 3);
        for (let q = start[row]; q < start[row + 1]; q++) out[i] += value[q] * source[3 * index[q] + (i % 3)];
      }
    },
    /** What each fine vertex gets from its three patches: read in their frames, then turned into space. */
    readPatches({ near, far, share, corners }, grids, frames, added) {
      added.fill(0);
      for (let k = 0; k < corners.length; k++) {
        const i = 3 * Math.floor(k / 3), a = 4 * k;
        for (let axis = 0; axis < 3; axis++) {
          const n = near[k] + axis, f = far[k] + axis, turned = 9 * corners[k] + 3 * axis;
          const onNear = share[a] * grids[n] + share[a + 1] * grids[n + 3];
          const d = onNear + share[a + 2] * grids[f] + share[a + 3] * grids[f + 3];
          for (let s = 0; s < 3; s++) added[i + s] += d * frames[turned + s];
        }
      }
    },
    /** Adds to each fine vertex a vector of its own, turned by a mixture of frames. */
    addTurned({ start, index, value }, own, frames, fine) {
      for (let i = 0; i < fine.length; i += 3) {
        for (let q = start[i / 3]; q < start[i / 3 + 1]; q++) addInFrame(own, i, frames, 9 * index[q], value[q], fine);
      }
    },
  };

  /** Adds the vector at i of `own`, given in a frame, times a weight to the vector at i of `fine`. */
  function addInFrame(own, i, frames, f, weight, fine) {
    const a = weight * own[i], b = weight * own[i + 1], c = weight * own[i + 2];
    for (let s = 0; s < 3; s++) fine[i + s] += a * frames[f + s] + b * frames[f + 3 + s] + c * frames[f + 6 + s];
  }

  class Decoder {
    /** Of what readRecording returns. After `decode` there is `origin` and, about it, vertices `coarse` and `fine`. */
    constructor({ about, arrays }, loops = plain) {
      const size = (name, axis) => about.arrays[name].shape[axis], vectors = (n) => loops.floats(3 * n);
      const count = size("stencil/corners", 0), fineCount = size("patches/corners", 0);
      Object.assign(this, { about, arrays, loops, size, rows: {}, origin: new Float64Array(3) });
      for (const name of ["filter", "middle", "surface", "smoothing", "turning"]) {
        if (!arrays[`${name}/start`]) continue;
        const [start, index] = ["start", "index"].map((part) => loops.indices(arrays[`${name}/${part}`]));
        this.rows[name] = { start, index, value: loops.floats(arrays[`${name}/value`]) };
      }
      [this.coarse, this.filtered, this.frames, this.contact] = [3, 3, 9, 1].map((n) => loops.floats(n * count));
      [this.fine, this.added, this.smoothed, this.correction] = Array.from({ length: 4 }, () => vectors(fineCount));
      [this.middle, this.held] = [this.rows.middle.start.length - 1, arrays.held.length].map(vectors);
      this.prepareNetwork(count);
      this.preparePatches(fineCount);
    }

    /** The network works region by region: row r is that of coarse vertex order[r]. */
    prepareNetwork(count) {
      const { arrays, loops, size } = this, place = arrays["network/place"], statics = size("network/place", 1);
      const [regions, width1, width2] = [0, 1, 2].map((axis) => size("network/weights_2", axis));
      const [inputs, atoms, units] = [size("network/center", 0), size("atoms/shapes", 0), size("novelty/bias_1", 0)];
      const order = arrays["network/order"], first = arrays["network/first_rows"];
      const rows = (width) => loops.floats(count * width);
      const [bias, hidden1, hidden2, output] = [width1, width1, width2, atoms].map(rows);
      repeat(arrays["network/bias_1"], bias);
      plain.multiplyAdd(place, arrays["network/place_weights"], bias, count, statics, width1);
      const [weights1, unitWeights, shapes] = ["network/weights_1", "novelty/weights_1", "atoms/shapes"]
        .map((name) => loops.floats(arrays[name]));
      const parts = Array.from({ length: regions }, (_, g) => {
        const part = (name, n = arrays[name].length / regions) => arrays[name].subarray(g * n, (g + 1) * n);
        const span = (values, width) => values.subarray(first[g] * width, first[g + 1] * width);
        return { rows: first[g + 1] - first[g], bias2: part("network/bias_2"), bias3: part("network/bias_3"),
          own1: span(hidden1, width1), own2: span(hidden2, width2), ownOutput: span(output, atoms),
          weights2: loops.floats(part("network/weights_2")), weights3: loops.floats(part("network/weights_3")) };
      });
      this.network = { count, inputs, width1, width2, units, atoms, order, bias, hidden1, output, weights1, unitWeights,
        shapes, parts, features: rows(inputs), hiddenUnits: rows(units) };
      this.grids = rows(arrays["atoms/mean"].length);
    }

    /** Where each fine vertex reads the grids of its three patches: bilinear shares of two pairs of nodes. */
    preparePatches(fineCount) {
      const { arrays, loops, rows, network: { order } } = this, cell = arrays["patches/cell"], rowOf = [];
      const corners = loops.indices(arrays["patches/corners"]), blend = loops.floats(arrays["patches/blend"]);
      const within = arrays["patches/within"], share = loops.floats(4 * cell.length);
      for (let k = 0; k < cell.length; k++) {
        const u = within[2 * k], v = within[2 * k + 1];
        share.set([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v].map((w) => w * blend[k]), 4 * k);
      }
      order.forEach((vertex, row) => (rowOf[vertex] = row));
      const nodes = arrays["atoms/mean"].length / 3, side = Math.sqrt(nodes); // of a patch's grid
      const [near, far] = [0, side].map((by) => (node, k) => 3 * (rowOf[corners[k]] * nodes + node + by))
        .map((offset) => loops.indices(Array.from(cell, offset)));
      this.patches = { near, far, share, corners };
      this.mean = loops.floats(arrays["patches/mean"]);
      const start = loops.indices(Array.from({ length: fineCount + 1 }, (_, i) => 3 * i));
      rows.turning ??= { start, index: corners, value: blend };
    }

    /** Decodes the garment at a time in frames, between two of them as well. */
    decode(time) {
      const { loops, rows, fine } = this;
      this.interpolate(time);
      loops.multiplySparse(rows.filter, this.coarse, this.filtered);
      loops.multiplySparse(rows.middle, this.filtered, this.middle);
      this.readFeatures();
      this.predict();
      loops.readPatches(this.patches, this.grids, this.frames, this.added);
      loops.multiplySparse(rows.surface, this.middle, fine);
      const added = rows.smoothing ? this.smoothed : this.added;
      if (rows.smoothing) loops.multiplySparse(rows.smoothing, this.added, added);
      for (let i = 0; i < fine.length; i++) fine[i] += added[i];
      loops.addTurned(rows.turning, this.mean, this.frames, fine);
      this.arrays.held.forEach((vertex, p) => fine.set(this.held.subarray(3 * p, 3 * p + 3), 3 * vertex));
      this.correct();
    }

    /** The recorded state at a time: the frames before and after it, mixed and scaled. */
    interpolate(time) {
      const last = this.about.frame_count - 1, k = Math.min(Math.max(Math.floor(time), 0), last);
      const next = Math.min(k + 1, last), after = Math.min(Math.max(time - k, 0), 1);
      for (const name of ["origin", "coarse", "contact", "held", "correction"]) {
        const steps = this.arrays[`frames/${name}`], out = this[name], count = out.length;
        const { scale } = this.about.arrays[`frames/${name}`], from = k * count, to = next * count;
        for (let i = 0; i < count; i++) out[i] = scale * ((1 - after) * steps[from + i] + after * steps[to + i]);
      }
    }

    /** Frames of the coarse vertices (axes along warp, weft and normal), and the network's input. */
    readFeatures() {
      const { arrays, contact, filtered: x, frames, network: { inputs, features, order } } = this;
      const { far, spacing, clip } = this.about, perSpacing = 1 / spacing;
      const p = new Float32Array(3 * POINTS), distance = new Float32Array(POINTS);
      const [corners, weights] = [arrays["stencil/corners"], arrays["stencil/weights"]];
      const [center, scale] = [arrays["network/center"], arrays["network/scale"]];
      for (let row = 0; row < order.length; row++) {
        const v = 9 * order[row], start = row * inputs;
        for (let q = 0, k = 3 * POINTS * order[row]; q < POINTS; q++, k += 3) {
          const a = weights[k], b = weights[k + 1], c = weights[k + 2];
          const i = corners[k], j = corners[k + 1], l = corners[k + 2];
          p[3 * q] = a * x[3 * i] + b * x[3 * j] + c * x[3 * l];
          p[3 * q + 1] = a * x[3 * i + 1] + b * x[3 * j + 1] + c * x[3 * l + 1];
          p[3 * q + 2] = a * x[3 * i + 2] + b * x[3 * j + 2] + c * x[3 * l + 2];
          distance[q] = a * contact[i] + b * contact[j] + c * contact[l];
        }
        for (let s = 0; s < 3; s++) frames[v + s] = p[3 * UP + s] - p[3 * DOWN + s];
        for (let s = 0; s < 3; s++) frames[v + 3 + s] = p[3 * RIGHT + s] - p[3 * LEFT + s];
        normalise(frames, v);
        cross(frames, v, v + 3, v + 6);
        normalise(frames, v + 6);
        cross(frames, v + 6, v, v + 3);
        let f = start;
        for (let q = 0; q < 3 * POINTS; q += 3) {
          if (q === 3 * CENTRE) continue;
          const d = p[q] - p[3 * CENTRE], e = p[q + 1] - p[3 * CENTRE + 1], g = p[q + 2] - p[3 * CENTRE + 2];
          for (let a = v; a < v + 9; a += 3, f++) {
            features[f] = (d * frames[a] + e * frames[a + 1] + g * frames[a + 2]) * perSpacing;
          }
        }
        for (const q of INNER) features[f++] = distance[q] / far;
        for (let i = 0; i < inputs; i++) {
          const standard = (features[start + i] - center[i]) * scale[i];
          features[start + i] = standard > clip ? clip : standard < -clip ? -clip : standard;
        }
      }
    }

    /** The network: from features to the grids' displacements, in the frames of their coarse vertices. */
    predict() {
      const { about, arrays, grids, loops, network: n } = this, { count, hiddenUnits, output } = n;
      n.hidden1.set(n.bias);
      loops.multiplyAdd(n.features, n.weights1, n.hidden1, count, n.inputs, n.width1);
      loops.rectify(n.hidden1);
      for (const { rows, own1, own2, ownOutput, weights2, weights3, bias2, bias3 } of n.parts) {
        repeat(bias2, own2);
        loops.multiplyAdd(own1, weights2, own2, rows, n.width1, n.width2);
        loops.rectify(own2);
        repeat(bias3, ownOutput);
        loops.multiplyAdd(own2, weights3, ownOutput, rows, n.width2, n.atoms);
      }
      repeat(arrays["novelty/bias_1"], hiddenUnits);
      loops.multiplyAdd(n.hidden1, n.unitWeights, hiddenUnits, count, n.width1, n.units);
      loops.rectify(hiddenUnits);
      const weights = arrays["novelty/weights_2"];
      for (let row = 0; row < count; row++) {
        let score = about.novelty_bias;
        for (let u = 0; u < n.units; u++) score += hiddenUnits[row * n.units + u] * weights[u];
        const amplitude = Math.min(Math.max((about.fade_end - score) / about.fade_width, 0), 1);
        for (let k = row * n.atoms; k < (row + 1) * n.atoms; k++) output[k] *= amplitude;
      }
      repeat(arrays["atoms/mean"], grids);
      loops.multiplyAdd(output, n.shapes, grids, count, n.atoms, arrays["atoms/mean"].length);
    }

    /** Adds the recorded corrections, each in the frame of the vertex' first patch. */
    correct() {
      const { correction: d, fine, frames } = this, corners = this.arrays["patches/corners"];
      for (let i = 0; i < d.length; i += 3) {
        if (d[i] || d[i + 1] || d[i + 2]) addInFrame(d, i, frames, 9 * corners[i], 1, fine);
      }
    }
  }

  /** Writes a row again and again. */
  function repeat(row, values) {
    values.set(row);
    for (let done = row.length; done < values.length; done *= 2) values.copyWithin(done, 0, done);
  }

  /** The vector at v gets length 1. */
  function normalise(values, v) {
    const length = Math.max(Math.sqrt(values[v] ** 2 + values[v + 1] ** 2 + values[v + 2] ** 2), 1e-12);
    for (let s = 0; s < 3; s++) values[v + s] /= length;
  }

  /** The cross product of the vectors at u and v, to w. */
  function cross(values, u, v, w) {
    values[w] = values[u + 1] * values[v + 2] - values[u + 2] * values[v + 1];
    values[w + 1] = values[u + 2] * values[v] - values[u] * values[v + 2];
    values[w + 2] = values[u] * values[v + 1] - values[u + 1] * values[v];
  }

  return { readRecording, Decoder, plain };
}

if (typeof module !== "undefined") module.exports = gubeDecoder();
