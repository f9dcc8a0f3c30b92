#include "server/tree/provisional_tree.h"
