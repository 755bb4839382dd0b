"use strict";

/**
 * Reads the file that docs/recording-file.md describes and decodes its frames. Lengths are in metres; vector i of an
 * array stands at 3 i. All is in one function, so that a page can hand its text to a worker.
 */
function gubeDecoder() {
  const TYPES = {
    int8: Int8Array, uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array,
    int32: Int32Array, uint32: Uint32Array, float32: Float32Array,
  };
  const SIDE = 11, NODES = SIDE * SIDE; // of a patch's grid
  const POINTS = 25, CENTRE = 12, UP = 17, DOWN = 7, LEFT = 11, RIGHT = 13; // of a stencil
  const INNER = [6, 7, 8, 11, 12, 13, 16, 17, 18];

  /** Header and arrays of a file, a Uint8Array. Arrays of frames stay whole numbers, the others get their values. */
  async function readRecording(bytes) {
    const text = new TextDecoder();
    if (text.decode(bytes.subarray(0, 8)) !== "gube rec") throw new Error("not a recorded garment");
    const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(8, true);
    const about = JSON.parse(text.decode(bytes.subarray(12, 12 + length)));
    if (about.version !== 1) throw new Error(`a recorded garment of version ${about.version}, not 1`);
    const steps = {}, arrays = {};
    for (const [name, entry] of Object.entries(about.arrays)) {
      const start = 12 + length + entry.offset;
      steps[name] = await unpacked(bytes.subarray(start, start + entry.size), entry);
    }
    for (const [name, entry] of Object.entries(about.arrays)) {
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

  /** Whole numbers times one scale for all, or times the scale of their line along an axis. */
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

    /** c += a b, row after row; a has `inner` columns, b and c have `columns`. */
    multiplyAdd(a, b, c, rows, inner, columns) {
      for (let i = 0; i < rows * inner; i++) {
        const factor = a[i], to = Math.floor(i / inner) * columns, from = (i % inner) * columns;
        if (factor !== 0) for (let j = 0; j < columns; j++) c[to + j] += factor * b[from + j];
      }
    },

    /** Negative numbers become zero. */
    rectify: (values) => values.forEach((value, i) => (values[i] = Math.max(value, 0))),

    /** A sparse matrix times vectors: out[i] = sum of value[q] source[index[q]] over start[i] <= q < start[i + 1]. */
    multiplySparse({ start, index, value }, source, out) {
      out.fill(0);
      for (let i = 0; i < start.length - 1; i++) {
        for (let q = start[i]; q < start[i + 1]; q++) {
          for (let a = 0; a < 3; a++) out[3 * i + a] += value[q] * source[3 * index[q] + a];
        }
      }
    },

    /** What each fine vertex gets from its three patches: in their frames first, then turned into space. */
    readPatches({ near, far, share, corners, factor, mean }, grids, frames, added) {
      added.fill(0);
      for (let k = 0; k < corners.length; k++) {
        const i = 3 * Math.floor(k / 3), s = 4 * k;
        for (let a = 0; a < 3; a++) {
          const n = near[k] + a, f = far[k] + a, axis = 9 * corners[k] + 3 * a;
          const d = share[s] * grids[n] + share[s + 1] * grids[n + 3] + share[s + 2] * grids[f] +
            share[s + 3] * grids[f + 3] + factor[k] * mean[i + a];
          for (let b = 0; b < 3; b++) added[i + b] += d * frames[axis + b];
        }
      }
    },
  };

  class Decoder {
    /**
     * What `decode` writes: `origin`, and about it the vertices `coarse` and `fine`. A recording is what readRecording
     * returns; loops are `plain` or do the same.
     */
    constructor({ about, arrays }, loops = plain) {
      Object.assign(this, { about, arrays, loops });
      const count = arrays["network/region"].length, vectors = (n) => loops.floats(3 * n);
      this.rows = {};
      for (const name of ["filter", "middle", "surface", "smoothing", "turning"]) {
        if (!arrays[`${name}/start`]) continue;
        const [start, index] = ["start", "index"].map((part) => loops.indices(arrays[`${name}/${part}`]));
        this.rows[name] = { start, index, value: loops.floats(arrays[`${name}/value`]) };
      }
      const fineCount = arrays["patches/mean"].length / 3, middleCount = this.rows.middle.start.length - 1;
      [this.coarse, this.filtered, this.middle, this.frames] = [count, count, middleCount, 3 * count].map(vectors);
      [this.fine, this.added, this.smoothed] = [fineCount, fineCount, fineCount].map(vectors);
      this.origin = new Float64Array(3);
      this.contact = new Float32Array(count);
      this.held = new Float32Array(3 * arrays.held.length);
      this.correction = new Float32Array(3 * fineCount);
      this.prepareNetwork(count);
      this.preparePatches(count);
    }

    /** The network works region by region: coarse vertex v has row rowOf[v]. */
    prepareNetwork(count) {
      const { arrays, loops } = this, region = arrays["network/region"], regions = Math.max(...region) + 1;
      const sizes = { inputs: arrays["network/center"].length, width1: arrays["network/bias_1"].length,
        units: arrays["novelty/bias_1"].length, width2: arrays["network/bias_2"].length / regions,
        atoms: arrays["network/bias_3"].length / regions };
      const order = [...region.keys()].sort((v, w) => region[v] - region[w] || v - w);
      this.rowOf = new Uint32Array(count);
      order.forEach((v, row) => (this.rowOf[v] = row));
      const statics = arrays["network/place"].length / count, bias = loops.floats(count * sizes.width1);
      const place = order.flatMap((v) => [...arrays["network/place"].subarray(v * statics, (v + 1) * statics)]);
      plain.multiplyAdd(place, arrays["network/place_weights"], bias, count, statics, sizes.width1);
      for (let i = 0; i < bias.length; i++) bias[i] += arrays["network/bias_1"][i % sizes.width1];
      const rows = (width) => loops.floats(count * width);
      this.network = { ...sizes, order, bias, features: rows(sizes.inputs), hidden1: rows(sizes.width1),
        hidden2: rows(sizes.width2), output: rows(sizes.atoms), hiddenUnits: rows(sizes.units),
        weights1: loops.floats(arrays["network/weights_1"]), unitWeights: loops.floats(arrays["novelty/weights_1"]) };
      const part = (name, g, length = arrays[name].length / regions) => arrays[name].subarray(g * length, (g + 1) * length);
      this.network.regions = Array.from({ length: regions }, (_, g) => {
        const first = region.filter((other) => other < g).length, end = first + region.filter((other) => other === g).length;
        const span = (values, width) => values.subarray(first * width, end * width);
        return { rows: end - first, hidden1: span(this.network.hidden1, sizes.width1),
          hidden2: span(this.network.hidden2, sizes.width2), output: span(this.network.output, sizes.atoms),
          weights2: loops.floats(part("network/weights_2", g)), bias2: part("network/bias_2", g),
          weights3: loops.floats(part("network/weights_3", g)), bias3: part("network/bias_3", g) };
      });
    }

    /** Where fine vertices read the grids. Nodes that none of them reads are left out of the grids. */
    preparePatches(count) {
      const { arrays, loops, rowOf, rows } = this, cell = arrays["patches/cell"], corners = arrays["patches/corners"];
      const used = [...new Set([...cell].flatMap((n) => [n, n + 1, n + SIDE, n + SIDE + 1]))].sort((m, n) => m - n);
      const column = new Map(used.map((node, k) => [node, 3 * k])), width = 3 * used.length;
      const kept = (values) => loops.floats([...values].filter((_, i) => column.has(Math.floor(i / 3) % NODES)));
      const offsets = (by) => loops.indices(Array.from(cell, (n, k) => rowOf[corners[k]] * width + column.get(n + by)));
      const blend = arrays["patches/blend"], within = arrays["patches/within"], share = loops.floats(4 * cell.length);
      for (let k = 0; k < cell.length; k++) {
        const u = within[2 * k], v = within[2 * k + 1];
        share.set([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v].map((w) => w * blend[k]), 4 * k);
      }
      this.patches = { width, share, near: offsets(0), far: offsets(SIDE), corners: loops.indices(corners),
        factor: loops.floats(rows.turning ? blend.length : blend), mean: loops.floats(arrays["patches/mean"]) };
      this.atoms = { shapes: kept(arrays["atoms/shapes"]), mean: kept(arrays["atoms/mean"]) };
      this.grids = loops.floats(count * width);
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
      if (rows.smoothing) loops.multiplySparse(rows.smoothing, this.added, this.smoothed);
      const added = rows.smoothing ? this.smoothed : this.added;
      for (let i = 0; i < fine.length; i++) fine[i] += added[i];
      if (rows.turning) this.addMeans();
      this.arrays.held.forEach((vertex, p) => fine.set(this.held.subarray(3 * p, 3 * p + 3), 3 * vertex));
      this.shortenEdges();
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
      const { far, spacing, clip } = this.about, p = new Float32Array(3 * POINTS), distance = new Float32Array(POINTS);
      const corners = arrays["stencil/corners"], weights = arrays["stencil/weights"];
      const center = arrays["network/center"], scale = arrays["network/scale"];
      for (let row = 0; row < order.length; row++) {
        const v = 9 * order[row], start = row * inputs;
        for (let q = 0, k = 3 * POINTS * order[row]; q < POINTS; q++, k += 3) {
          const a = weights[k], b = weights[k + 1], c = weights[k + 2], i = corners[k], j = corners[k + 1], l = corners[k + 2];
          p[3 * q] = a * x[3 * i] + b * x[3 * j] + c * x[3 * l];
          p[3 * q + 1] = a * x[3 * i + 1] + b * x[3 * j + 1] + c * x[3 * l + 1];
          p[3 * q + 2] = a * x[3 * i + 2] + b * x[3 * j + 2] + c * x[3 * l + 2];
          distance[q] = a * contact[i] + b * contact[j] + c * contact[l];
        }
        for (let s = 0; s < 3; s++) {
          frames[v + s] = p[3 * UP + s] - p[3 * DOWN + s];
          frames[v + 3 + s] = p[3 * RIGHT + s] - p[3 * LEFT + s];
        }
        normalise(frames, v);
        cross(frames, v, v + 3, v + 6);
        normalise(frames, v + 6);
        cross(frames, v + 6, v, v + 3);
        let f = start;
        for (let q = 0; q < 3 * POINTS; q += 3) {
          if (q === 3 * CENTRE) continue;
          const d = p[q] - p[3 * CENTRE], e = p[q + 1] - p[3 * CENTRE + 1], g = p[q + 2] - p[3 * CENTRE + 2];
          for (let a = v; a < v + 9; a += 3) features[f++] = (d * frames[a] + e * frames[a + 1] + g * frames[a + 2]) / spacing;
        }
        for (let a = v; a < v + 9; a += 3) features[f++] = -frames[a + 1];
        for (const q of INNER) features[f++] = distance[q] / far;
        for (let i = 0; i < inputs; i++) {
          const standard = (features[start + i] - center[i]) * scale[i];
          features[start + i] = standard > clip ? clip : standard < -clip ? -clip : standard;
        }
      }
    }

    /** The network: from features to the grids' displacements, in the frames of their coarse vertices. */
    predict() {
      const { about, arrays, atoms, grids, loops, network: n, patches: { width } } = this, count = n.order.length;
      n.hidden1.set(n.bias);
      loops.multiplyAdd(n.features, n.weights1, n.hidden1, count, n.inputs, n.width1);
      loops.rectify(n.hidden1);
      for (const { rows, hidden1, hidden2, output, weights2, bias2, weights3, bias3 } of n.regions) {
        repeat(bias2, hidden2);
        loops.multiplyAdd(hidden1, weights2, hidden2, rows, n.width1, n.width2);
        loops.rectify(hidden2);
        repeat(bias3, output);
        loops.multiplyAdd(hidden2, weights3, output, rows, n.width2, n.atoms);
      }
      repeat(arrays["novelty/bias_1"], n.hiddenUnits);
      loops.multiplyAdd(n.hidden1, n.unitWeights, n.hiddenUnits, count, n.width1, n.units);
      loops.rectify(n.hiddenUnits);
      const weights = arrays["novelty/weights_2"], { hiddenUnits, output } = n;
      for (let row = 0; row < count; row++) {
        let score = about.novelty_bias;
        for (let u = 0; u < n.units; u++) score += hiddenUnits[row * n.units + u] * weights[u];
        const amplitude = Math.min(Math.max((about.fade_end - score) / about.fade_width, 0), 1);
        for (let k = row * n.atoms; k < (row + 1) * n.atoms; k++) output[k] *= amplitude;
      }
      repeat(atoms.mean, grids);
      loops.multiplyAdd(n.output, atoms.shapes, grids, count, n.atoms, width);
    }

    /** Means of a delivered mesh: each turns with its own mixture of frames. */
    addMeans() {
      const { start, index, value } = this.rows.turning, mean = this.arrays["patches/mean"];
      for (let i = 0; i < start.length - 1; i++) {
        for (let q = start[i]; q < start[i + 1]; q++) this.addTurned(mean, i, index[q], value[q]);
      }
    }

    /** Adds vector i of `source`, given in the frame of a coarse vertex, to fine vertex i. */
    addTurned(source, i, vertex, weight) {
      const { fine, frames } = this, f = 9 * vertex, k = 3 * i;
      const a = weight * source[k], b = weight * source[k + 1], c = weight * source[k + 2];
      for (let s = 0; s < 3; s++) fine[k + s] += a * frames[f + s] + b * frames[f + 3 + s] + c * frames[f + 6 + s];
    }

    /** Takes back a share of the stretch of one edge after the other; without a root, as Jakobsen (2001) does. */
    shortenEdges() {
      const { fine, about: { free_edges: free, stretch_share: share } } = this;
      const ends = this.arrays["edges/ends"], lengths = this.arrays["edges/lengths"];
      for (let e = 0; e < lengths.length; e++) {
        const i = 3 * ends[2 * e], j = 3 * ends[2 * e + 1], wanted = lengths[e] * lengths[e];
        const x = fine[j] - fine[i], y = fine[j + 1] - fine[i + 1], z = fine[j + 2] - fine[i + 2];
        const squared = x * x + y * y + z * z;
        if (squared <= wanted) continue;
        const taken = share * (1 - (2 * wanted) / (squared + wanted)), first = e < free ? taken / 2 : 0; // or it is held
        fine[i] += first * x, fine[i + 1] += first * y, fine[i + 2] += first * z;
        fine[j] -= (taken - first) * x, fine[j + 1] -= (taken - first) * y, fine[j + 2] -= (taken - first) * z;
      }
    }

    /** Adds the recorded corrections, each in the frame of the vertex' first patch. */
    correct() {
      const { correction: d } = this, corners = this.arrays["patches/corners"];
      for (let k = 0; k < d.length; k += 3) if (d[k] || d[k + 1] || d[k + 2]) this.addTurned(d, k / 3, corners[k], 1);
    }
  }

  /** Writes a row again and again. */
  function repeat(row, values) {
    values.set(row);
    for (let done = row.length; done < values.length; done *= 2) values.copyWithin(done, 0, done);
  }

  /** The vector at v gets length 1. */
  function normalise(values, v) {
    const x = values[v], y = values[v + 1], z = values[v + 2], length = Math.max(Math.sqrt(x * x + y * y + z * z), 1e-12);
    values[v] = x / length, values[v + 1] = y / length, values[v + 2] = z / length;
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
