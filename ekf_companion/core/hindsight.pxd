cdef void carry(double[::1] x, double[::1] y, double[::1] w) noexcept nogil
cdef void move(
    double[::1] before, double[::1] after, double[::1] w, Py_ssize_t Phi, double[:, ::1] prior,
    double[:, ::1] gain
) noexcept nogil
cdef void renew(
    double[::1] before, double[::1] after, double[:, ::1] prior, double[:, ::1] gain
) noexcept nogil
cdef void subtract(double[::1] y, double[:, ::1] prior, double[:, ::1] change) noexcept nogil
cdef void factor(double[:, ::1] a) noexcept nogil
cdef void solve(double[:, ::1] root, double[:, ::1] g) noexcept nogil
cdef void absorb(
    double[::1] before, double[::1] y, double[::1] w, double[:, ::1] gain, double[:, ::1] change,
    double[:, ::1] half
) noexcept nogil
