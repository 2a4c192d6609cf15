"""The renderer's inner loops, compiled by numba (cached on disk; `compile_all` builds them before the first image)."""

import numpy as np
from numba import njit

LIT, HIT = 2, 1


@njit(cache=True, fastmath=True)
def shade_points(
    origin: np.ndarray,
    directions: np.ndarray,
    distance: np.ndarray,
    face: np.ndarray,
    bary_u: np.ndarray,
    bary_v: np.ndarray,
    faces: np.ndarray,
    vertex_normals: np.ndarray,
    vertex_albedo: np.ndarray,
    face_body: np.ndarray,
    gloss: np.ndarray,
    light_from_base: np.ndarray,
    light_position: np.ndarray,
    light_k: np.ndarray,
    light_size: np.ndarray,
    light_distorted: bool,
    vignetting: float,
    ambient: float,
    up: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    uv: np.ndarray,
    gain: np.ndarray,
    sky: np.ndarray,
    albedo: np.ndarray,
    body: np.ndarray,
    flags: np.ndarray,
) -> None:
    """Surface, projector coordinates and light transport of first hits; shadows are not known here.

    In: origin (3,), directions (n, 3), hits (n,), the scene's arrays, light_from_base (4, 4), light_position (3,),
    light_k (fx fy cx cy), light_size (width height), light_distorted: uv is given in ideal normalised coordinates
    instead of pixels, vignetting: the projector's loss at the panel's corner, ambient: strength, up (3,).
    Out: points (n, 3), normals (n, 3), uv (n, 2), gain (n, 3): radiance per unit of projector light (pi folded in),
    sky (n, 3): radiance by ambient light, albedo (n, 3), body (n,) int32, flags (n,): HIT, and LIT where the
    projector may reach the point.
    """
    fx, fy, cx, cy = light_k[0], light_k[1], light_k[2], light_k[3]
    lx, ly, lz = light_position[0], light_position[1], light_position[2]
    reach2 = (max(cx, light_size[0] - cx) / fx) ** 2 + (max(cy, light_size[1] - cy) / fy) ** 2
    for i in range(directions.shape[0]):
        flags[i] = 0
        body[i] = -1
        for k in range(3):
            gain[i, k] = 0.0
            sky[i, k] = 0.0
            albedo[i, k] = 0.0
        f = face[i]
        if f < 0:
            uv[i, 0] = -1e6
            uv[i, 1] = -1e6
            continue
        t = float(distance[i])
        dx, dy, dz = float(directions[i, 0]), float(directions[i, 1]), float(directions[i, 2])
        x, y, z = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        wu, wv = bary_u[i], bary_v[i]
        w = 1.0 - wu - wv
        nx = w * vertex_normals[a, 0] + wu * vertex_normals[b, 0] + wv * vertex_normals[c, 0]
        ny = w * vertex_normals[a, 1] + wu * vertex_normals[b, 1] + wv * vertex_normals[c, 1]
        nz = w * vertex_normals[a, 2] + wu * vertex_normals[b, 2] + wv * vertex_normals[c, 2]
        s = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
        nx, ny, nz = nx * s, ny * s, nz * s
        points[i, 0], points[i, 1], points[i, 2] = x, y, z
        normals[i, 0], normals[i, 1], normals[i, 2] = nx, ny, nz
        body[i] = face_body[f]
        flags[i] = HIT
        ambient_here = ambient * (0.6 + 0.4 * (nx * up[0] + ny * up[1] + nz * up[2]))
        r0 = w * vertex_albedo[a, 0] + wu * vertex_albedo[b, 0] + wv * vertex_albedo[c, 0]
        r1 = w * vertex_albedo[a, 1] + wu * vertex_albedo[b, 1] + wv * vertex_albedo[c, 1]
        r2 = w * vertex_albedo[a, 2] + wu * vertex_albedo[b, 2] + wv * vertex_albedo[c, 2]
        albedo[i, 0], albedo[i, 1], albedo[i, 2] = r0, r1, r2
        sky[i, 0], sky[i, 1], sky[i, 2] = r0 * ambient_here, r1 * ambient_here, r2 * ambient_here
        px = light_from_base[0, 0] * x + light_from_base[0, 1] * y + light_from_base[0, 2] * z + light_from_base[0, 3]
        py = light_from_base[1, 0] * x + light_from_base[1, 1] * y + light_from_base[1, 2] * z + light_from_base[1, 3]
        pz = light_from_base[2, 0] * x + light_from_base[2, 1] * y + light_from_base[2, 2] * z + light_from_base[2, 3]
        if pz <= 1e-3:
            uv[i, 0] = -1e6
            uv[i, 1] = -1e6
            continue
        tx, ty = px / pz, py / pz
        if light_distorted:
            uv[i, 0], uv[i, 1] = tx, ty
        else:
            uv[i, 0], uv[i, 1] = fx * tx + cx, fy * ty + cy
        u, v = fx * tx + cx, fy * ty + cy
        inside = u > -8.0 and v > -8.0 and u < light_size[0] + 7.0 and v < light_size[1] + 7.0
        qx, qy, qz = lx - x, ly - y, lz - z
        d2 = qx * qx + qy * qy + qz * qz
        inv = 1.0 / np.sqrt(d2)
        cosine = (nx * qx + ny * qy + nz * qz) * inv
        if cosine <= 0.0 or not (inside or light_distorted):
            continue
        flags[i] = HIT | LIT
        # equal flux through every projector pixel: irradiance = cosine / (cos(theta) z^2), cos(theta) = z / d
        irradiance = cosine / (pz * inv * pz * pz)
        irradiance *= 1.0 - vignetting * (tx * tx + ty * ty) / reach2
        shiny = 0.0
        ks = gloss[body[i], 0]
        if ks > 0.0:
            length = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
            hx, hy, hz = qx * inv - dx * length, qy * inv - dy * length, qz * inv - dz * length
            h = 1.0 / np.sqrt(hx * hx + hy * hy + hz * hz + 1e-30)
            half = (nx * hx + ny * hy + nz * hz) * h
            if half > 0.0:
                e = gloss[body[i], 1]
                shiny = ks * (e + 8.0) / 8.0 * half**e
        gain[i, 0] = ((1.0 - ks) * r0 + shiny) * irradiance
        gain[i, 1] = ((1.0 - ks) * r1 + shiny) * irradiance
        gain[i, 2] = ((1.0 - ks) * r2 + shiny) * irradiance


@njit(cache=True)
def uneven_cells(
    points: np.ndarray,
    normals: np.ndarray,
    albedo: np.ndarray,
    body: np.ndarray,
    flags: np.ndarray,
    uneven: np.ndarray,
) -> None:
    """Mark cells of a node lattice (h, w, ...) over which nothing may be interpolated; uneven (h-1, w-1) uint8.

    A cell is even when its four nodes lie on one body, are all lit or all dark, are painted alike, have normals within
    about 8 degrees and lie in each other's tangent planes.
    """
    h, w = body.shape
    for i in range(h - 1):
        for j in range(w - 1):
            bad = False
            b0, f0 = body[i, j], flags[i, j]
            for k in range(1, 4):
                ii, jj = i + (k >> 1), j + (k & 1)
                if body[ii, jj] != b0 or flags[ii, jj] != f0:
                    bad = True
            if not bad and b0 >= 0:
                for k in range(4):
                    i1, j1 = i + (k >> 1), j + (k & 1)
                    i2, j2 = (
                        (i, j + 1) if k == 0 else ((i + 1, j + 1) if k == 1 else ((i, j) if k == 2 else (i + 1, j)))
                    )
                    c = 0.0
                    d2, s1, s2 = 0.0, 0.0, 0.0
                    for a in range(3):
                        r1, r2 = albedo[i1, j1, a], albedo[i2, j2, a]
                        if abs(r1 - r2) > 0.1 * (r1 + r2):
                            bad = True
                        n1, n2 = normals[i1, j1, a], normals[i2, j2, a]
                        d = points[i2, j2, a] - points[i1, j1, a]
                        c += n1 * n2
                        d2 += d * d
                        s1 += d * n1
                        s2 += d * n2
                    if c < 0.99 or s1 * s1 > 0.02 * d2 or s2 * s2 > 0.02 * d2:
                        bad = True
            uneven[i, j] = 1 if bad else 0


@njit(cache=True, fastmath=True, inline="always")
def _look_up(light: np.ndarray, scale: float, u: float, v: float) -> tuple[np.floating, np.floating, np.floating]:
    """Bilinear light (h, w, 3) at projector pixel (u, v) of the unscaled panel; nothing outside."""
    h, w = light.shape[0], light.shape[1]
    x = (u + 0.5) * scale - 0.5
    y = (v + 0.5) * scale - 0.5
    if not (x >= 0.0 and y >= 0.0 and x < w - 1 and y < h - 1):
        return np.float32(0.0), np.float32(0.0), np.float32(0.0)
    x0, y0 = int(x), int(y)
    fx, fy, one = np.float32(x - x0), np.float32(y - y0), np.float32(1.0)
    w00, w01, w10, w11 = (one - fy) * (one - fx), (one - fy) * fx, fy * (one - fx), fy * fx
    above, below = light[y0], light[y0 + 1]
    return (
        w00 * above[x0, 0] + w01 * above[x0 + 1, 0] + w10 * below[x0, 0] + w11 * below[x0 + 1, 0],
        w00 * above[x0, 1] + w01 * above[x0 + 1, 1] + w10 * below[x0, 1] + w11 * below[x0 + 1, 1],
        w00 * above[x0, 2] + w01 * above[x0 + 1, 2] + w10 * below[x0, 2] + w11 * below[x0 + 1, 2],
    )


@njit(cache=True, fastmath=True)
def gather(
    light: np.ndarray,
    scale: float,
    uv: np.ndarray,
    gain: np.ndarray,
    sky: np.ndarray,
    slot_of_cell: np.ndarray,
    fine_uv: np.ndarray,
    fine_gain: np.ndarray,
    fine_sky: np.ndarray,
    cell: np.ndarray,
    fraction: np.ndarray,
    part: np.ndarray,
    samples: int,
    across: int,
    image: np.ndarray,
) -> None:
    """Integrate the radiance over each pixel's samples x samples sub-pixels into image (H, W, 3) float32.

    Sub-pixel k of an axis lies in cell cell[k] of the node lattice at fraction[k] and is sample part[k] of that cell's
    `across`. Cells with slot_of_cell >= 0 have their own traced samples fine_* (slots, across * across, .).
    """
    height, width = image.shape[0], image.shape[1]
    share, one = np.float32(1.0 / (samples * samples)), np.float32(1.0)
    for i in range(height):
        for j in range(width):
            red = green = blue = np.float32(0.0)
            for si in range(samples):
                ky = i * samples + si
                ci, fy = cell[ky], fraction[ky]
                sky0, sky1, gain0, gain1, uv0, uv1 = sky[ci], sky[ci + 1], gain[ci], gain[ci + 1], uv[ci], uv[ci + 1]
                for sj in range(samples):
                    kx = j * samples + sj
                    a = cell[kx]
                    b = a + 1
                    slot = slot_of_cell[ci, a]
                    if slot >= 0:
                        p = part[ky] * across + part[kx]
                        at, own = fine_sky[slot, p], fine_gain[slot, p]
                        red, green, blue = red + at[0], green + at[1], blue + at[2]
                        if own[0] + own[1] + own[2] > 0.0:
                            light_r, light_g, light_b = _look_up(light, scale, fine_uv[slot, p, 0], fine_uv[slot, p, 1])
                            red += own[0] * light_r
                            green += own[1] * light_g
                            blue += own[2] * light_b
                        continue
                    fx = fraction[kx]
                    w00, w01, w10, w11 = (one - fy) * (one - fx), (one - fy) * fx, fy * (one - fx), fy * fx
                    red += w00 * sky0[a, 0] + w01 * sky0[b, 0] + w10 * sky1[a, 0] + w11 * sky1[b, 0]
                    green += w00 * sky0[a, 1] + w01 * sky0[b, 1] + w10 * sky1[a, 1] + w11 * sky1[b, 1]
                    blue += w00 * sky0[a, 2] + w01 * sky0[b, 2] + w10 * sky1[a, 2] + w11 * sky1[b, 2]
                    g0 = w00 * gain0[a, 0] + w01 * gain0[b, 0] + w10 * gain1[a, 0] + w11 * gain1[b, 0]
                    g1 = w00 * gain0[a, 1] + w01 * gain0[b, 1] + w10 * gain1[a, 1] + w11 * gain1[b, 1]
                    g2 = w00 * gain0[a, 2] + w01 * gain0[b, 2] + w10 * gain1[a, 2] + w11 * gain1[b, 2]
                    if g0 + g1 + g2 > 0.0:
                        u = w00 * uv0[a, 0] + w01 * uv0[b, 0] + w10 * uv1[a, 0] + w11 * uv1[b, 0]
                        v = w00 * uv0[a, 1] + w01 * uv0[b, 1] + w10 * uv1[a, 1] + w11 * uv1[b, 1]
                        light_r, light_g, light_b = _look_up(light, scale, u, v)
                        red += g0 * light_r
                        green += g1 * light_g
                        blue += g2 * light_b
            image[i, j, 0] = red * share
            image[i, j, 1] = green * share
            image[i, j, 2] = blue * share


@njit(cache=True)
def capsules_between(
    light: np.ndarray,
    points: np.ndarray,
    flags: np.ndarray,
    ends: np.ndarray,
    radii: np.ndarray,
    blocked: np.ndarray,
) -> None:
    """Mark points (n, 3) whose segment to light (3,) passes within radii (k,) of the segments ends (k, 2, 3)."""
    for i in range(points.shape[0]):
        blocked[i] = False
        if flags[i] & LIT == 0:
            continue
        d0, d1, d2 = light[0] - points[i, 0], light[1] - points[i, 1], light[2] - points[i, 2]
        dd = d0 * d0 + d1 * d1 + d2 * d2
        for k in range(ends.shape[0]):
            e0, e1, e2 = ends[k, 1, 0] - ends[k, 0, 0], ends[k, 1, 1] - ends[k, 0, 1], ends[k, 1, 2] - ends[k, 0, 2]
            r0, r1, r2 = points[i, 0] - ends[k, 0, 0], points[i, 1] - ends[k, 0, 1], points[i, 2] - ends[k, 0, 2]
            ee = e0 * e0 + e1 * e1 + e2 * e2
            de = d0 * e0 + d1 * e1 + d2 * e2
            dr = d0 * r0 + d1 * r1 + d2 * r2
            er = e0 * r0 + e1 * r1 + e2 * r2
            determinant = dd * ee - de * de
            s = 0.0
            if determinant > 1e-12:
                s = min(max((de * er - ee * dr) / determinant, 0.0), 1.0)
            t = (de * s + er) / max(ee, 1e-12)
            if t < 0.0:
                t = 0.0
                s = min(max(-dr / dd, 0.0), 1.0)
            elif t > 1.0:
                t = 1.0
                s = min(max((de - dr) / dd, 0.0), 1.0)
            g0, g1, g2 = r0 + s * d0 - t * e0, r1 + s * d1 - t * e1, r2 + s * d2 - t * e2
            if g0 * g0 + g1 * g1 + g2 * g2 < radii[k] * radii[k]:
                blocked[i] = True
                break
