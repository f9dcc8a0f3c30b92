#include "server/mesh/canonical.h"
