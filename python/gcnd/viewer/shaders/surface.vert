// One corner of one face: blended position, the face's normal, and the value to colour by.
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;

uniform usampler2D faces;
uniform sampler2D positionsBefore;
uniform sampler2D positionsAfter;
uniform usampler2D valuesBefore;
uniform usampler2D valuesAfter;
uniform float blend;
uniform int valueKind; // 0: none, 1: one a face, 2: one a vertex
uniform float valueScale; // value at the end of the colour scale, in the 16-bit steps of the values

flat out vec3 faceNormal;
out vec3 viewPosition;
out vec3 barycentric;
out float value; // 1 at the end of the colour scale, below 0 where there is none

const uint UNKNOWN = 65535u;

ivec2 cell(uint i) {
  return ivec2(int(i & 4095u), int(i >> 12u));
}

vec3 corner(uint vertexId) {
  ivec2 at = cell(vertexId);
  return mix(texelFetch(positionsBefore, at, 0).xyz, texelFetch(positionsAfter, at, 0).xyz, blend);
}

float valueOf(uint i) {
  ivec2 at = cell(i);
  uvec2 steps = uvec2(texelFetch(valuesBefore, at, 0).r, texelFetch(valuesAfter, at, 0).r);
  if (steps.x == UNKNOWN || steps.y == UNKNOWN) return -1.0;
  return mix(float(steps.x), float(steps.y), blend) / valueScale;
}

void main() {
  uint faceId = uint(gl_VertexID / 3);
  int own = gl_VertexID % 3;
  uvec3 ids = texelFetch(faces, cell(faceId), 0).xyz;
  vec3 a = corner(ids.x), b = corner(ids.y), c = corner(ids.z);
  vec3 position = own == 0 ? a : (own == 1 ? b : c);
  // Lengths are taken out first: products of the short edges of a fine mesh would lose digits, or vanish.
  vec3 ab = b - a, ac = c - a;
  float size = max(max(length(ab), length(ac)), 1e-30);
  faceNormal = normalMatrix * cross(ab / size, ac / size);
  barycentric = vec3(own == 0, own == 1, own == 2);
  value = valueKind == 0 ? -1.0 : valueOf(valueKind == 1 ? faceId : ids[own]);
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  viewPosition = seen.xyz;
  gl_Position = projectionMatrix * seen;
}
