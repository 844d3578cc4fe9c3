#include "shim.h"

#ifdef WHIT_EMBREE_4
struct WhitQuery {
  struct RTCRayQueryContext context;
  struct RTCIntersectArguments intersect;
  struct RTCOccludedArguments occluded;
};
#define TRACE1(name, arguments) name##1(scene, ray, &query->arguments)
#define TRACE(name, arguments) name(valid, scene, ray, &query->arguments)
#else
struct WhitQuery {
  struct RTCIntersectContext context;
};
#define TRACE1(name, arguments) name##1(scene, &query->context, ray)
#define TRACE(name, arguments) name(valid, scene, &query->context, ray)
#endif

_Static_assert(offsetof(struct RTCRayHit16, hit) == sizeof(struct RTCRay16), "a hit follows its ray");
_Static_assert(sizeof(struct RTCRay16) == 12 * 64, "a ray packet is twelve rows of sixteen values");

unsigned int whitHeaderVersion(void) { return RTC_VERSION; }

size_t whitQuerySize(void) { return sizeof(struct WhitQuery); }

void whitInitQuery(struct WhitQuery *query, int coherent) {
#ifdef WHIT_EMBREE_4
  enum RTCRayQueryFlags flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
  rtcInitRayQueryContext(&query->context);
  rtcInitIntersectArguments(&query->intersect);
  query->intersect.context = &query->context;
  query->intersect.flags = flags;
  rtcInitOccludedArguments(&query->occluded);
  query->occluded.context = &query->context;
  query->occluded.flags = flags;
#else
  rtcInitIntersectContext(&query->context);
  query->context.flags =
      coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
#endif
}

void whitIntersect1(RTCScene scene, struct WhitQuery *query, struct RTCRayHit *ray) {
  TRACE1(rtcIntersect, intersect);
}
void whitIntersect4(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRayHit4 *ray) {
  TRACE(rtcIntersect4, intersect);
}
void whitIntersect8(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRayHit8 *ray) {
  TRACE(rtcIntersect8, intersect);
}
void whitIntersect16(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRayHit16 *ray) {
  TRACE(rtcIntersect16, intersect);
}

void whitOccluded1(RTCScene scene, struct WhitQuery *query, struct RTCRay *ray) {
  TRACE1(rtcOccluded, occluded);
}
void whitOccluded4(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRay4 *ray) {
  TRACE(rtcOccluded4, occluded);
}
void whitOccluded8(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRay8 *ray) {
  TRACE(rtcOccluded8, occluded);
}
void whitOccluded16(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRay16 *ray) {
  TRACE(rtcOccluded16, occluded);
}

size_t whitInstPrimOffset16(void) {
#if defined(RTC_GEOMETRY_INSTANCE_ARRAY)
  return offsetof(struct RTCRayHit16, hit.instPrimID);
#else
  return 0;
#endif
}
