#include "server/geometry/triangle_test.h"
