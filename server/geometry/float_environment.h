// Whether the processor's floating-point arithmetic is the one that every predicate here counts on.

#ifndef SERVER_GEOMETRY_FLOAT_ENVIRONMENT_H_
#define SERVER_GEOMETRY_FLOAT_ENVIRONMENT_H_

namespace deltaray {

// What is wrong with the arithmetic of the calling thread, which threads that it starts inherit: that it does not round
// to nearest even, or takes subnormal numbers for 0. nullptr where nothing is. Libraries that were compiled with
// -ffast-math set such modes as they are loaded, and triangles are missed then without a sign.
const char* FloatEnvironmentFault();

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_FLOAT_ENVIRONMENT_H_
