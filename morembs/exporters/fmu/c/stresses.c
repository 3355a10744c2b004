/* Von Mises stresses of tensors xx, yy, zz, xy, yz, zx. */
static void von_mises(const real *stress, real *result)
{
    for (int i = 0; i < STRESSES; i++, stress += 6) {
        real a = stress[0] - stress[1], b = stress[1] - stress[2], c = stress[2] - stress[0];
        real shear = stress[3] * stress[3] + stress[4] * stress[4] + stress[5] * stress[5];
        result[i] = sqrt((a * a + b * b + c * c) / 2 + 3 * shear);
    }
}
