// The inner loops of decoder.js in WebAssembly, in AssemblyScript: the same as its `plain`, on addresses in memory.
// Numbers take four bytes. Vectors are loaded four numbers at a time: what stands behind the third is not used.

/** c += a b. Rows of b times zeros of a are left out: rectified units are zero more often than not. */
export function multiplyAdd(
  a: usize, b: usize, c: usize, rows: i32, inner: i32, columns: i32, work: usize // for rows (2 inner + 2) numbers
): void {
  const width = <usize>columns << 2, entries = work + (<usize>rows << 3);
  // For each row of a, the addresses of the rows of b and their factors, but for zeros; and where each list ends.
  let end = entries;
  for (let i = 0; i < rows; i++) {
    let row = b;
    for (let k = 0; k < inner; k++) {
      const factor = load<f32>(a);
      store<usize>(end, row);
      store<f32>(end, factor, 4);
      end += <usize>(factor != 0) << 3;
      a += 4;
      row += width;
    }
    store<usize>(work + (<usize>i << 3), end);
  }
  // A block of columns of b for all rows: it stays in the fastest cache meanwhile.
  let j: usize = 0;
  while (j < width) {
    const left = width - j;
    let list = entries, to = c + j;
    for (let i = 0; i < rows; i++) {
      const last = load<usize>(work + (<usize>i << 3));
      if (left >= 192) add48(list, last, j, to);
      else if (left >= 64) add16(list, last, j, to);
      else if (left >= 32) add8(list, last, j, to);
      else addLast(list, last, j, to, left);
      list = last;
      to += width;
    }
    j += left >= 192 ? 192 : left >= 64 ? 64 : left >= 32 ? 32 : 16;
  }
}

// @ts-ignore: decorator
@inline
function product(factor: v128, row: usize, offset: usize): v128 {
  return f32x4.mul(factor, v128.load(row + offset));
}

/** Adds the listed rows to 48 numbers, which stay in registers meanwhile. */
// @ts-ignore: decorator
@inline
function add48(list: usize, end: usize, j: usize, c: usize): void {
  let c0 = v128.load(c), c1 = v128.load(c, 16), c2 = v128.load(c, 32), c3 = v128.load(c, 48);
  let c4 = v128.load(c, 64), c5 = v128.load(c, 80), c6 = v128.load(c, 96), c7 = v128.load(c, 112);
  let c8 = v128.load(c, 128), c9 = v128.load(c, 144), c10 = v128.load(c, 160), c11 = v128.load(c, 176);
  for (let p = list; p < end; p += 8) {
    const row = load<usize>(p) + j, factor = v128.load32_splat(p, 4);
    c0 = f32x4.add(c0, product(factor, row, 0));
    c1 = f32x4.add(c1, product(factor, row, 16));
    c2 = f32x4.add(c2, product(factor, row, 32));
    c3 = f32x4.add(c3, product(factor, row, 48));
    c4 = f32x4.add(c4, product(factor, row, 64));
    c5 = f32x4.add(c5, product(factor, row, 80));
    c6 = f32x4.add(c6, product(factor, row, 96));
    c7 = f32x4.add(c7, product(factor, row, 112));
    c8 = f32x4.add(c8, product(factor, row, 128));
    c9 = f32x4.add(c9, product(factor, row, 144));
    c10 = f32x4.add(c10, product(factor, row, 160));
    c11 = f32x4.add(c11, product(factor, row, 176));
  }
  v128.store(c, c0);
  v128.store(c, c1, 16);
  v128.store(c, c2, 32);
  v128.store(c, c3, 48);
  v128.store(c, c4, 64);
  v128.store(c, c5, 80);
  v128.store(c, c6, 96);
  v128.store(c, c7, 112);
  v128.store(c, c8, 128);
  v128.store(c, c9, 144);
  v128.store(c, c10, 160);
  v128.store(c, c11, 176);
}

// @ts-ignore: decorator
@inline
function add16(list: usize, end: usize, j: usize, c: usize): void {
  let c0 = v128.load(c), c1 = v128.load(c, 16), c2 = v128.load(c, 32), c3 = v128.load(c, 48);
  for (let p = list; p < end; p += 8) {
    const row = load<usize>(p) + j, factor = v128.load32_splat(p, 4);
    c0 = f32x4.add(c0, product(factor, row, 0));
    c1 = f32x4.add(c1, product(factor, row, 16));
    c2 = f32x4.add(c2, product(factor, row, 32));
    c3 = f32x4.add(c3, product(factor, row, 48));
  }
  v128.store(c, c0);
  v128.store(c, c1, 16);
  v128.store(c, c2, 32);
  v128.store(c, c3, 48);
}

// @ts-ignore: decorator
@inline
function add8(list: usize, end: usize, j: usize, c: usize): void {
  let c0 = v128.load(c), c1 = v128.load(c, 16);
  for (let p = list; p < end; p += 8) {
    const row = load<usize>(p) + j, factor = v128.load32_splat(p, 4);
    c0 = f32x4.add(c0, product(factor, row, 0));
    c1 = f32x4.add(c1, product(factor, row, 16));
  }
  v128.store(c, c0);
  v128.store(c, c1, 16);
}

/** Adds the listed rows to the last `left` bytes of a row, at most four numbers of which are written. */
// @ts-ignore: decorator
@inline
function addLast(list: usize, end: usize, j: usize, c: usize, left: usize): void {
  let sum = v128.load(c);
  for (let p = list; p < end; p += 8) {
    sum = f32x4.add(sum, product(v128.load32_splat(p, 4), load<usize>(p) + j, 0));
  }
  v128.store32_lane(c, sum, 0);
  if (left > 4) v128.store32_lane(c, sum, 1, 4);
  if (left > 8) v128.store32_lane(c, sum, 2, 8);
  if (left > 12) v128.store32_lane(c, sum, 3, 12);
}

/** Negative numbers become zero. */
export function rectify(values: usize, count: i32): void {
  const end = values + (<usize>count << 2);
  for (; values + 16 <= end; values += 16) v128.store(values, f32x4.max(v128.load(values), f32x4.splat(0)));
  for (; values < end; values += 4) store<f32>(values, max<f32>(load<f32>(values), 0));
}

/** A sparse matrix times vectors. */
export function multiplySparse(
  start: usize, index: usize, value: usize, source: usize, out: usize, rows: i32
): void {
  let q = load<u32>(start);
  for (let i = 0; i < rows; i++) {
    const end = load<u32>(start, 4);
    let sum = f32x4.splat(0);
    for (; q < end; q++) {
      const weight = v128.load32_splat(value + (q << 2));
      sum = f32x4.add(sum, f32x4.mul(weight, v128.load(source + 12 * load<u32>(index + (q << 2)))));
    }
    v128.store(out, sum); // the next row overwrites the fourth number
    start += 4;
    out += 12;
  }
}

/** Writes three numbers and not four: behind them stands another vertex. */
// @ts-ignore: decorator
@inline
function storeVector(at: usize, vector: v128): void {
  v128.store64_lane(at, vector, 0);
  v128.store32_lane(at, vector, 2, 8);
}

/** The vector d, given in a frame, in space. */
// @ts-ignore: decorator
@inline
function inSpace(d: v128, frame: usize): v128 {
  const x = product(v128.shuffle<f32>(d, d, 0, 0, 0, 0), frame, 0);
  const y = product(v128.shuffle<f32>(d, d, 1, 1, 1, 1), frame, 12);
  return f32x4.add(f32x4.add(x, y), product(v128.shuffle<f32>(d, d, 2, 2, 2, 2), frame, 24));
}

/** What the patches add to the fine vertices, in space. Offsets count numbers. */
export function readPatches(
  near: usize, far: usize, share: usize, corners: usize, grids: usize, frames: usize, added: usize, rows: i32
): void {
  for (let i = 0; i < rows; i++) {
    let sum = f32x4.splat(0);
    for (let c = 0; c < 3; c++) {
      const at = grids + (load<u32>(near) << 2), further = grids + (load<u32>(far) << 2);
      let d = product(v128.load32_splat(share), at, 0);
      d = f32x4.add(d, product(v128.load32_splat(share, 4), at, 12));
      d = f32x4.add(d, product(v128.load32_splat(share, 8), further, 0));
      d = f32x4.add(d, product(v128.load32_splat(share, 12), further, 12));
      sum = f32x4.add(sum, inSpace(d, frames + 36 * load<u32>(corners)));
      near += 4;
      far += 4;
      corners += 4;
      share += 16;
    }
    v128.store(added, sum);
    added += 12;
  }
}

/** Adds to each fine vertex a vector of its own, turned by a mixture of frames. */
export function addTurned(
  start: usize, index: usize, value: usize, own: usize, frames: usize, fine: usize, rows: i32
): void {
  let q = load<u32>(start);
  for (let i = 0; i < rows; i++) {
    const end = load<u32>(start, 4);
    let sum = f32x4.splat(0);
    for (; q < end; q++) {
      const turned = inSpace(v128.load(own), frames + 36 * load<u32>(index + (q << 2)));
      sum = f32x4.add(sum, f32x4.mul(v128.load32_splat(value + (q << 2)), turned));
    }
    storeVector(fine, f32x4.add(sum, v128.load(fine)));
    start += 4;
    own += 12;
    fine += 12;
  }
}
