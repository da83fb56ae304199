// A pixel's share of a Gaussian, to be blended front to back over (0, 0, 0, transmittance 1): the compositing of
// kernels/splat.cl, whose formulas these are. Only its end at T_MIN is missing: what comes behind changes less than that.
precision highp float;

uniform vec2 size;
flat in vec2 mean;
flat in vec3 conic;
flat in float lo;
flat in vec3 color;
out vec4 pixel;

void main() {
  float dx = gl_FragCoord.x - mean.x, dy = size.y - gl_FragCoord.y - mean.y, u = dx - conic.y * dy;
  float log2_alpha = lo - (conic.x * u * u + conic.z * dy * dy);
  if (!(log2_alpha >= LOG2_ALPHA_MIN)) discard;
  float alpha = min(exp2(log2_alpha), ALPHA_MAX);
  pixel = vec4(color * alpha, alpha);
}
