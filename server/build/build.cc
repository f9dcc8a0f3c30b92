#include "server/build/build.h"
