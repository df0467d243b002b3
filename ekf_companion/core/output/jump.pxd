cimport cython
@cython.locals(
    sample=tuple, end=tuple,
    rx=cython.double, ry=cython.double, rz=cython.double,
    fx=cython.double, fy=cython.double, fz=cython.double,
    ax=cython.double, ay=cython.double, az=cython.double,
    gx=cython.double, gy=cython.double, gz=cython.double,
    w=cython.double, x=cython.double, y=cython.double, z=cython.double,
    dw=cython.double, dx=cython.double, dy=cython.double, dz=cython.double,
    tw=cython.double, tx=cython.double, ty=cython.double, tz=cython.double,
    share=cython.double, half=cython.double, scale=cython.double
)
cpdef tuple unexplained_step(tuple last, tuple now, list samples, double dt, tuple before, double ahead)
cdef double rotate_x(double w, double x, double y, double z, double a, double b, double c) noexcept
cdef double rotate_y(double w, double x, double y, double z, double a, double b, double c) noexcept
cdef double rotate_z(double w, double x, double y, double z, double a, double b, double c) noexcept
