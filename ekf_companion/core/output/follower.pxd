cimport cython
cdef class Follower:
    cdef double numbers[55]
    cdef double sent[55]
    cdef readonly double pos_n[3]
    cdef readonly double vel_n[3]
    cdef double squares[3]
    cdef double left_pos[3]
    cdef double left_vel[3]
    cdef double shift[3]
    cdef double C[3][3]
    cdef double square[3][3]
    cdef double cross[3][3]
    cdef double half[3][3]
    cdef double lag, age, left_yaw, yaw
    cdef readonly double std_position, std_velocity, std_yaw, std_attitude
    cdef bint is_mean, is_moved
    cdef readonly bint is_spreading
    cdef long long t_ns
    cdef readonly list samples
    cdef public tuple place
    cdef readonly tuple step, jumps
    cdef tuple last, before
    cpdef forget(self)
    cpdef clear(self, bint frame_too)
    @cython.locals(n="double*", v="double*", dt=cython.double, ahead=cython.double, found=tuple)
    cpdef bint look(self, long long t_ns, bytes numbers, tuple stated, bytes relative=*) except -1
    cdef void find_stds(self) noexcept
    cpdef double std_ground_speed(self) except -1
    @cython.locals(
        least=cython.double, most=cython.double, slow=cython.double, size=cython.double,
        x=cython.double, y=cython.double, z=cython.double, within=cython.double
    )
    cdef judge(self, double dt, tuple stated)
    cdef void decay(self, double dt) noexcept
    cpdef spread(self, bint position, bint velocity, bint yaw)
    cpdef move_frame(self)
    cpdef bytes express(self, double climb, double errors, bint is_local)
    cdef void rotate_from(self, double *n) noexcept
    cdef void scale_climb(self, double factor) noexcept
    cdef void scale_errors(self, Py_ssize_t start, double root) noexcept
    cdef void add_left(self) noexcept
    @cython.locals(
        azimuthal=cython.double, radius=cython.double, lat=cython.double, lon=cython.double,
        alt=cython.double, to_north=cython.double, to_east=cython.double, lat_0=cython.double,
        lon_0=cython.double, alt_0=cython.double
    )
    cdef put_in_place(self, tuple place)
    cdef void turn_velocity(self) noexcept
    cdef void turn_rows(self, Py_ssize_t start) noexcept
cdef Py_ssize_t triangle(Py_ssize_t row, Py_ssize_t column) noexcept
cdef double single(double value) noexcept
cdef bint shorten(double *vector, double by) noexcept
cdef void project(
    double *n, bint is_azimuthal, double radius, double lat, double lon, double lat_0, double lon_0
) noexcept
