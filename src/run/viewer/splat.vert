// One corner of the rectangle that a Gaussian's ellipse needs; four per instance, instances front to back.
// Defines nothing of its own: projection, covariance and determinant are those of shape_of(), the anti-aliasing that of
// log2_left(), colours those of sh_basis() in kernels/projection.clh; the conic, the clamp of colours and the culling those of
// kernels/project.cl. tests/viewer.rs holds pictures of both together. The constants come with the scene (src/base/constants.rs).
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D geometry;     // 3 texels: x y z log2(opacity) | scales | quaternion w x y z
uniform sampler2D coefficients; // SH_TEXELS texels: coefficient by coefficient, red green blue of each
uniform vec3 row0, row1, row2;  // rotation, scene to camera
uniform vec3 translation, center;
uniform vec4 lens;              // fx fy cx cy, pixels
uniform vec4 limits;            // x/z min max, y/z min max
uniform vec2 size;              // pixels
in uint index;
flat out vec2 mean;  // pixels, y down
flat out vec3 conic; // a, r, c: log2(alpha) = lo - (a u^2 + c dy^2), u = dx - r dy
flat out float lo;
flat out vec3 color;

vec4 texel(sampler2D from, int at) {
  int width = textureSize(from, 0).x;
  return texelFetch(from, ivec2(at % width, at / width), 0);
}

mat3 rotation(vec4 q) { // columns; the rows of the kernels' row-major matrix
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec3 sh_color(int gaussian, vec3 d) {
  float basis[SH_COUNT];
  basis[0] = 0.28209479177387814;
#if SH_DEGREE > 0
  float x = d.x, y = d.y, z = d.z;
  basis[1] = -0.4886025119029199 * y;
  basis[2] = 0.4886025119029199 * z;
  basis[3] = -0.4886025119029199 * x;
#endif
#if SH_DEGREE > 1
  float xx = x * x, yy = y * y, zz = z * z;
  basis[4] = 1.0925484305920792 * x * y;
  basis[5] = -1.0925484305920792 * y * z;
  basis[6] = 0.31539156525252005 * (2.0 * zz - xx - yy);
  basis[7] = -1.0925484305920792 * x * z;
  basis[8] = 0.5462742152960396 * (xx - yy);
#endif
#if SH_DEGREE > 2
  basis[9] = -0.5900435899266435 * y * (3.0 * xx - yy);
  basis[10] = 2.890611442640554 * x * y * z;
  basis[11] = -0.4570457994644658 * y * (4.0 * zz - xx - yy);
  basis[12] = 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
  basis[13] = -0.4570457994644658 * x * (4.0 * zz - xx - yy);
  basis[14] = 1.445305721320277 * z * (xx - yy);
  basis[15] = -0.5900435899266435 * x * (xx - 3.0 * yy);
#endif
  float v[4 * SH_TEXELS];
  for (int k = 0; k < SH_TEXELS; k++) {
    vec4 four = texel(coefficients, gaussian * SH_TEXELS + k);
    v[4 * k] = four.x;
    v[4 * k + 1] = four.y;
    v[4 * k + 2] = four.z;
    v[4 * k + 3] = four.w;
  }
  vec3 sum = vec3(0.5);
  for (int k = 0; k < SH_COUNT; k++) sum += basis[k] * vec3(v[3 * k], v[3 * k + 1], v[3 * k + 2]);
  return sum;
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside: culled
  int gaussian = int(index);
  vec4 first = texel(geometry, 3 * gaussian), q = texel(geometry, 3 * gaussian + 2);
  vec3 s = texel(geometry, 3 * gaussian + 1).xyz, p = first.xyz;
  vec3 t = vec3(dot(row0, p), dot(row1, p), dot(row2, p)) + translation;
  if (!(t.z > NEAR)) return;
  float iz = 1.0 / t.z, u = clamp(t.x * iz, limits.x, limits.y), v = clamp(t.y * iz, limits.z, limits.w);
  mat3 rot = rotation(q);
  vec3 d = (lens.x * iz * (row0 - u * row2)) * rot, e = (lens.y * iz * (row1 - v * row2)) * rot; // rows of J W R
  vec3 a = d * s, b = e * s, area = s.yzx * s.zxy * cross(d, e);
  float aa = dot(a, a), bb = dot(b, b), det0 = dot(area, area);
  float sxx = aa + BLUR, syy = bb + BLUR, sxy = dot(a, b), det = det0 + BLUR * (aa + bb) + BLUR * BLUR;
  lo = first.w;
#if ANTI_ALIAS
  if (!(det0 > 0.0)) return;
  lo += 0.5 * log2(det0 / det);
#endif
  float tau = lo - LOG2_ALPHA_MIN;
  if (!(tau > 0.0 && det < 1e37)) return;
  mean = lens.xy * t.xy * iz + lens.zw;
  conic = vec3(0.7213475204444817 * (syy / det), sxy / syy, 0.7213475204444817 / syy);
  vec3 away = p - center;
  color = sh_color(gaussian, dot(away, away) > 0.0 ? normalize(away) : vec3(0.0, 0.0, 1.0));
  if (!all(lessThan(abs(color), vec3(COLOR_MAX)))) return;
  color = max(color, 0.0);
  // The ellipse of the cut by its axes, half a pixel wider.
  float half_gap = 0.5 * length(vec2(sxx - syy, 2.0 * sxy)), large = 0.5 * (sxx + syy) + half_gap;
  float angle = half_gap > 0.0 ? 0.5 * atan(2.0 * sxy, sxx - syy) : 0.0;
  vec2 axis = vec2(cos(angle), sin(angle));
  vec2 reach = sqrt(1.3862943611198906 * tau * vec2(large, det / large)) + 0.5;
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  vec2 at = mean + corner.x * reach.x * axis + corner.y * reach.y * vec2(-axis.y, axis.x);
  gl_Position = vec4(2.0 * at.x / size.x - 1.0, 1.0 - 2.0 * at.y / size.y, 0.0, 1.0);
}
