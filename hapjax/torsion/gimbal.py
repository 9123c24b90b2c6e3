"""Two-point torsion by instrumented gimbals: MHS section 3.2, solution 1."""

from .gravity_drop import GravityDrop


class Gimbal(GravityDrop):
    """Two-point torsion, MHS section 3.2, solution 1: the fingers' gimbals turn the object about the grasp's line.

    While exactly two fingers touch an object and A >= A_crit, it turns about the line u through the two god-objects
    by the mean of what the two gimbals turn by in the step. A gimbal's angle counts right-handed about u, which goes
    from the earlier of the two fingers to the later, in their order. With a smaller A the object is held by the share
    that `GravityDrop` takes of the torque, and so is left to gravity as the grip opens: with gimbals at rest the two
    models are one.

    **Arguments:** `critical_area`, A_crit in m^2, above 0; `twist_damping`, N m s/rad, 0 or above, of the object's spin
    about u against that of the gimbals. `None`: none.
    """

    needs_gimbal = True
