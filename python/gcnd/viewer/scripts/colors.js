// The colour scale viridis at 33 even steps; straight lines between them. Tests compare it with matplotlib's.
const COLOR_STOPS = [
  "#440154", "#470d60", "#48186a", "#482374", "#472d7b", "#453681", "#424086", "#3f4989", "#3b528b", "#375a8d", "#33638d",
  "#2f6a8e", "#2c728e", "#297a8e", "#26818e", "#23898e", "#21908c", "#1f988b", "#1f9f88", "#21a685", "#28ae80", "#31b57b",
  "#3ebc74", "#4cc26c", "#5dc963", "#6ece58", "#82d34c", "#96d83f", "#abdc32", "#c0df24", "#d5e21a", "#eae51a", "#fde725",
];

/** RGBA bytes of the scale, for a texture of one row. */
function colorBytes() {
  const bytes = new Uint8Array(4 * COLOR_STOPS.length);
  COLOR_STOPS.forEach((stop, i) => {
    const value = parseInt(stop.slice(1), 16);
    bytes.set([value >> 16, (value >> 8) & 255, value & 255, 255], 4 * i);
  });
  return bytes;
}

/** The scale as a CSS background, from left to right. */
function colorGradient() {
  return `linear-gradient(to right, ${COLOR_STOPS.join(", ")})`;
}

