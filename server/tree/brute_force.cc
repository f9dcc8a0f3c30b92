#include "server/tree/brute_force.h"
