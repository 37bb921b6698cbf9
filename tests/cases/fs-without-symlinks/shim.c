// Preloaded into a program, makes its file system one that has no symbolic links.
#include <errno.h>

int symlink(const char *target, const char *path) {
    errno = EPERM;
    return -1;
}

int symlinkat(const char *target, int dir, const char *path) {
    errno = EPERM;
    return -1;
}
