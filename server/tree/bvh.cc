#include "server/tree/bvh.h"
