// node decode_recording.js RECORDING WEB TIME...: the fine vertices in the world at these times [frames], float64 numbers,
// decoded in plain JavaScript and then with the loops in WebAssembly.
const fs = require("fs");
const [path, web, ...times] = process.argv.slice(2);
const { readRecording, Decoder } = require(`${web}/decoder.js`);
const gubeLoops = require(`${web}/loops.js`);

(async () => {
  const recording = await readRecording(new Uint8Array(fs.readFileSync(path)));
  const loops = await gubeLoops(fs.readFileSync(`${web}/built/loops.wasm`));
  for (const decoder of [new Decoder(recording), new Decoder(recording, loops)]) {
    for (const time of times) {
      decoder.decode(Number(time));
      const world = Float64Array.from(decoder.fine, (x, i) => x + decoder.origin[i % 3]);
      fs.writeSync(1, Buffer.from(world.buffer));
    }
  }
})();
