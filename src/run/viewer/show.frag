// The composited colour over the background.
precision highp float;

uniform highp sampler2D composited; // red green blue, transmittance
uniform vec3 background;
out vec4 pixel;

void main() {
  vec4 c = texelFetch(composited, ivec2(gl_FragCoord.xy), 0);
  pixel = vec4(c.rgb + c.a * background, 1.0);
}
