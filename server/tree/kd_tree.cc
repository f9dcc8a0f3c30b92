#include "server/tree/kd_tree.h"
