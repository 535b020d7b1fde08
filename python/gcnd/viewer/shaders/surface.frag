// Flat shading; colours stand for values, so light changes them little.
precision highp float;
precision highp sampler2D;

uniform sampler2D colors;
uniform float colorCount;
uniform bool isColored;
uniform bool hasWires;

flat in vec3 faceNormal;
in vec3 viewPosition;
in vec3 barycentric;
in float value;

out vec4 pixel;

const vec3 LIGHT = normalize(vec3(-0.35, 0.55, 0.75)); // view frame: right, up, to the viewer
const vec3 CLAY = vec3(0.88, 0.86, 0.82);
const vec3 NO_VALUE = vec3(0.62);
const vec3 WIRE = vec3(0.08);

void main() {
  float length2 = dot(faceNormal, faceNormal);
  vec3 normal = length2 > 0.0 ? faceNormal * inversesqrt(length2) : vec3(0.0, 0.0, 1.0);
  bool isBack = dot(normal, viewPosition) > 0.0;
  if (isBack) normal = -normal;

  vec3 base = CLAY;
  if (isColored) {
    float place = (clamp(value, 0.0, 1.0) * (colorCount - 1.0) + 0.5) / colorCount;
    base = value < 0.0 ? NO_VALUE : texture(colors, vec2(place, 0.5)).rgb;
  }
  float ambient = isColored ? 0.6 : 0.3;
  // A second, weak light from the other side keeps shape in what the first does not reach.
  float light = 1.05 * max(dot(normal, LIGHT), 0.0) + 0.3 * max(dot(normal, vec3(0.8, -0.3, 0.5)), 0.0);
  vec3 color = base * min(ambient + (1.0 - ambient) * light, 1.0);
  if (isBack) color *= 0.55;

  if (hasWires) {
    vec3 width = fwidth(barycentric);
    vec3 apart = barycentric / max(width, vec3(1e-6));
    float line = 1.0 - smoothstep(0.3, 1.2, min(apart.x, min(apart.y, apart.z)));
    // Where a face is smaller than a few pixels, lines would be all there is to see.
    float room = 1.0 - smoothstep(0.25, 0.6, max(width.x, max(width.y, width.z)));
    color = mix(color, WIRE, 0.75 * line * room);
  }
  pixel = vec4(color, 1.0);
}
